"""Messages that outlive all hosts, in a file that is whole or reported, and older than nothing."""

from __future__ import annotations

import os
import shutil
import signal
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calling import call
from llfsm.whiteboard import BoardError, Slot
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.errors import BoardCorruptError, BoardMirroredError, BoardPermissionError
from llfsm.whiteboard.mirror.batches import Version
from llfsm.whiteboard.mirror.keeper import Keeper
from llfsm.whiteboard.mirror.settings import KeepSettings
from thoroughness import examples
from waiting import wait_for

from .conftest import NAME, Host, MakeHost, number_slot
from .part import NUMBER, Number, Part, Text

KEPT, DRIVEN = number_slot("map/tiles"), number_slot("cmd_vel")
SETTINGS = '[keep]\nfile = "depot.kept"\nslots = ["map/*"]\n'


class Kept:
    """A file, and what becomes of it."""

    def __init__(self, folder: Path, *slots: str) -> None:
        self.path = folder / "depot.kept"
        self._settings = KeepSettings(file=str(self.path), slots=slots or ("*",))
        self._open: list[Keeper] = []
        self._now_s = 0.0

    def open(self, board: str = "board") -> Keeper:
        self._open.append(Keeper(self._settings, board))
        return self._open[-1]

    def close(self) -> None:
        while self._open:
            self._open.pop().close()

    def write(self, part: Part, refuse: Callable[[str, str], object] = pytest.fail) -> None:
        """Keep what has changed on a host."""
        keeper = self._open[-1] if self._open else self.open()
        self._now_s += 1
        keeper.follow(part.watch(0), part.store, self._now_s, refuse)
        keeper.finish(part.store, refuse)

    def restored(self, part: Part | None = None) -> tuple[Part, list[str]]:
        """Return a host that is started with it, and what was reported."""
        part, reported = part or Part(host=9), list[str]()
        self.close()
        self.open().restore(part.store, lambda _, why: reported.append(why))
        return part, reported


@pytest.fixture
def kept(tmp_path: Path) -> Iterator[Kept]:
    kept = Kept(tmp_path)
    yield kept
    kept.close()


def added(part: Part, value: int, slot: Slot[Any] = NUMBER) -> Part:
    part.board.add_message(slot, slot.type(value))
    return part


def version(part: Part, slot: Slot[Any] = NUMBER) -> Version | None:
    return part.store.version(part.store.cell(slot.name))


def test_a_message_comes_back_with_its_type_and_version(kept: Kept) -> None:
    before = added(Part(), 5)
    kept.write(before)
    part, reported = kept.restored()
    assert reported == []
    assert part.get(part.board.find("number")).value == 5
    assert part.board.find("number").schema == NUMBER.schema
    assert version(part) == version(before)


def test_the_file_has_the_latest_message_of_each_slot(kept: Kept) -> None:
    part = Part()
    other = Slot("other", Number)
    for value in range(3):
        part.now_ns += 1
        kept.write(added(added(part, value), 10 * value, other))
    kept.write(added(part, 7))
    part, _ = kept.restored()
    assert [part.get(slot).value for slot in (NUMBER, other)] == [7, 20]


def test_what_is_newer_on_the_board_stays_and_is_kept(kept: Kept) -> None:
    kept.write(added(Part(), 1))
    newer = Part(host=3)
    newer.now_ns += 10
    part, reported = kept.restored(added(newer, 2))
    assert (part.get().value, reported) == (2, [])
    kept.write(part)
    assert kept.restored()[0].get().value == 2


def test_what_is_older_on_the_board_is_replaced(kept: Kept) -> None:
    kept.write(added(Part(), 1))
    older = Part(host=3)
    older.now_ns -= 10
    assert kept.restored(added(older, 2))[0].get().value == 1


def test_only_chosen_slots_are_kept_and_none_about_processes(tmp_path: Path) -> None:
    kept = Kept(tmp_path, "map/*", "*/Wall")
    part = Part()
    for name in ("map/tiles", "cmd_vel", "llfsm/machine/Wall"):
        added(part, 1, Slot(name, Number))
    kept.write(part)
    part, _ = kept.restored()
    assert [info.name for info in part.board.slots()] == ["map/tiles"]
    kept.close()


def test_a_slot_of_another_type_is_reported_and_stays_in_the_file(kept: Kept) -> None:
    kept.write(added(Part(), 1))
    text = Part(host=3)
    text.board.add_message(Slot("number", Text), Text("mine"))
    _, (reported,) = kept.restored(text)
    assert "holds test/Text here, test/Number at the sender" in reported
    assert kept.restored()[0].get().value == 1


def test_it_is_not_written_more_than_once_a_second(kept: Kept) -> None:
    keeper, part = kept.open(), Part()
    written = set()
    for step in range(30):
        part.now_ns += 1
        keeper.follow(added(part, step).watch(0), part.store, step / 10, pytest.fail)
        keeper.wait_written()
        written.add(kept.path.stat().st_ino)
    assert len(written) <= 1 + 3
    keeper.finish(part.store, pytest.fail)
    assert kept.restored()[0].get().value == 29


@pytest.fixture
def whole(kept: Kept) -> bytes:
    kept.write(added(Part(), 5))
    kept.close()
    return kept.path.read_bytes()


@settings(
    max_examples=examples(60),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=st.data())
def test_a_damaged_file_is_reported_and_left_as_it_is(
    kept: Kept, whole: bytes, data: st.DataObject
) -> None:
    at = data.draw(st.integers(0, len(whole) - 1))
    damaged = data.draw(
        st.sampled_from([whole[:at], whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :]])
    )
    kept.path.write_bytes(damaged)
    with pytest.raises(BoardCorruptError, match=r"depot\.kept: damaged, or not .*; move it"):
        kept.open()
    assert kept.path.read_bytes() == damaged


def test_an_unfinished_file_beside_it_harms_nothing(kept: Kept) -> None:
    """As one is left whose daemon was killed."""
    kept.write(added(Part(), 5))
    kept.close()
    (kept.path.parent / "depot.kept.new").write_bytes(bytes(10_000))
    part, _ = kept.restored()
    part.now_ns += 1
    kept.write(added(part, 6))
    assert kept.restored()[0].get().value == 6


def test_two_daemons_do_not_share_a_file(kept: Kept, tmp_path: Path) -> None:
    kept.write(added(Part(), 5))
    with pytest.raises(BoardMirroredError, match="another daemon keeps messages in this file"):
        Kept(tmp_path).open()
    kept.close()
    Kept(tmp_path).open().close()


def test_it_is_as_private_as_the_board(kept: Kept) -> None:
    """Also one that an earlier version has made for all to read, or was left unfinished so."""
    umask = os.umask(0o022)
    try:
        kept.write(added(Part(), 5))
        kept.close()
        assert stat.S_IMODE(kept.path.stat().st_mode) == 0o600
        kept.path.chmod(0o644)
        left = kept.path.parent / "depot.kept.new"
        left.touch(0o644)
        part, _ = kept.restored()
        assert stat.S_IMODE(kept.path.stat().st_mode) == 0o600
        left.touch(0o644)
        part.now_ns += 1
        kept.write(added(part, 6))
        assert stat.S_IMODE(kept.path.stat().st_mode) == 0o600
    finally:
        os.umask(umask)


def test_the_file_of_another_board_is_refused(kept: Kept) -> None:
    kept.open("north")
    kept.close()
    with pytest.raises(BoardError, match="of the board 'north', and this one is 'south'"):
        kept.open("south")


def test_a_folder_that_is_missing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(BoardError, match=r"none/depot\.kept: No such file or directory"):
        Kept(tmp_path / "none").open()


@pytest.mark.parametrize("name", ["depot.kept", "depot.kept.new"])
@pytest.mark.parametrize(
    "make",
    [os.mkfifo, lambda path: path.touch() or os.chown(path, 12345, -1)],
    ids=["pipe", "of another user"],
)
def test_what_is_no_file_of_this_user_is_refused(
    tmp_path: Path, name: str, make: Callable[[Path], object]
) -> None:
    """Before anything is read: a pipe would be waited for."""
    kept = Kept(tmp_path)
    try:
        make(tmp_path / name)
    except PermissionError as error:
        pytest.skip(f"only root can give a file away: {error}")
    with pytest.raises(BoardPermissionError, match=rf"{name}: belongs to another user, or is not"):
        kept.open()


def test_a_link_in_place_of_the_new_file_is_not_followed(tmp_path: Path) -> None:
    """In a folder that others may write, it may lead to any file."""
    kept, other = Kept(tmp_path), tmp_path / "other"
    other.write_text("precious")
    (tmp_path / "depot.kept.new").symlink_to(other)
    with pytest.raises(BoardError, match=r"depot.kept.new: .*; messages cannot be kept"):
        kept.open()
    assert other.read_text() == "precious"


def test_a_write_that_fails_is_reported_and_tried_again(kept: Kept) -> None:
    keeper, reported = kept.open(), list[str]()
    shutil.rmtree(kept.path.parent)
    kept.write(added(Part(), 5), lambda what, _: reported.append(what))
    assert set(reported) == {f"{kept.path} cannot be written"}
    kept.path.parent.mkdir()
    keeper.finish(Part().store, pytest.fail)
    assert kept.restored()[0].get().value == 5


def keeping(host: Host) -> list[str]:
    config = host.directory / "daemon.toml"
    config.write_text(SETTINGS)
    return ["--config", str(config)]


def test_a_message_outlives_all_hosts(make_host: MakeHost) -> None:
    """Each process is killed, all boards are removed, and a new host gets it from the file."""
    depot, robot, later = (make_host(name) for name in ("depot", "robot", "later"))
    depot.start(*keeping(depot))
    robot.start(connect=[depot])
    robot.add(1, KEPT)
    robot.add(2, DRIVEN)
    file = depot.directory / "depot.kept"
    wait_for(lambda: b"map/tiles" in file.read_bytes(), "it is kept")
    wait_for(lambda: depot.get(DRIVEN) == 2)
    for host in (robot, depot):
        host.end(signal.SIGKILL)
        remove_board(NAME, host.directory)
    depot.reopen()
    depot.start(*keeping(depot))
    assert depot.get(KEPT) == 1
    later.start(connect=[depot])
    wait_for(lambda: later.get(KEPT) == 1, "a new host gets it")
    assert depot.get(DRIVEN) is None
    later.add(3, KEPT)
    wait_for(lambda: depot.get(KEPT) == 3, "and can add on top of it")
    assert depot.end() == 0
    assert os.listdir(depot.directory).count("depot.kept.new") == 0


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ('[keep]\nfile = "depot.kept"\n', "missing required field `slots`"),
        ('[keep]\nfile = "depot.kept"\nslots = []\n', "length >= 1"),
        ('[keep]\nfile = ""\nslots = ["*"]\n', "length >= 1"),
        ('[keep]\nfile = "daemon.toml"\nslots = ["*"]\n', "daemon.toml: damaged, or not a file of"),
    ],
)
def test_settings_that_cannot_be_used_are_errors(tmp_path: Path, text: str, error: str) -> None:
    config = tmp_path / "daemon.toml"
    config.write_text(text)
    done = call(
        "whiteboard", "daemon", "-b", NAME, "--directory", str(tmp_path), "--config", str(config),
        "--listen", "tcp/127.0.0.1:0", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode != 0
    assert error in done.stderr
    assert config.read_text() == text
