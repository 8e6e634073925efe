"""A kept file has its latest record, or the one before, however its process ends."""

from __future__ import annotations

import os
import random
import signal
from collections.abc import Callable
from multiprocessing import Pipe
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.runtime import KeepError
from llfsm.runtime.keeping import _kept_file as module
from llfsm.runtime.keeping._kept_file import KeptFile
from small_disks import small_disk
from thoroughness import examples
from waiting import wait_for

records = st.lists(st.binary(max_size=20_000), min_size=1, max_size=12)


def read(path: Path) -> bytes | None:
    """Return the latest record of a file that nobody has opened."""
    file = KeptFile(path)
    file.close()
    return file.latest


@settings(max_examples=examples(60))
@given(records=records)
def test_the_latest_record_comes_back(records: list[bytes]) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder, "kept")
        for _ in range(2):
            file = KeptFile(path)
            for record in records:
                file.write(record)
            file.close()
            assert read(path) == records[-1]
        assert path.stat().st_mode & 0o777 == 0o600
        assert [*Path(folder).iterdir()] == [path]


@settings(max_examples=examples(100))
@given(records=st.lists(st.binary(max_size=300), min_size=2, max_size=12), data=st.data())
def test_a_record_that_was_not_written_to_its_end_leaves_the_one_before(
    records: list[bytes], data: st.DataObject
) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder, "kept")
        file = KeptFile(path)
        for record in records[:-1]:
            file.write(record)
        before = path.read_bytes()
        file.write(records[-1])
        file.close()
        after = path.read_bytes()
        changed = [place for place, byte in enumerate(after) if byte != before[place]]
        first, last = changed[0], changed[-1]
        cut = data.draw(st.integers(first, last))
        path.write_bytes(after[:cut] + before[cut:])
        assert read(path) == records[-2]


@settings(max_examples=examples(100))
@given(cut=st.integers(0, 5000), flip=st.integers(0, 23))
def test_damage_is_refused(cut: int, flip: int) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder, "kept")
        file = KeptFile(path)
        file.write(b"record")
        file.close()
        whole = path.read_bytes()
        damaged = bytearray(whole)
        damaged[16 + flip] ^= 1
        for content in (whole[:cut], bytes(damaged), b"\0" * len(whole)):
            path.write_bytes(content)
            with pytest.raises(KeepError, match="is damaged; to begin anew, remove it"):
                read(path)
            assert path.read_bytes() == content


def test_a_file_is_one_process_s(tmp_path: Path) -> None:
    file = KeptFile(tmp_path / "kept")
    file.write(b"1")
    for _ in range(2):
        with pytest.raises(KeepError, match="another process keeps its machines there"):
            KeptFile(tmp_path / "kept")
        file.write(b"2" * 10_000)  # in a file that has taken the place of the first one
    file.close()
    assert read(tmp_path / "kept") == b"2" * 10_000


def test_one_that_is_removed_meanwhile_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SYNC_S", 0.01)
    path, number = tmp_path / "kept", 0

    def is_there() -> bool:
        nonlocal number
        number += 1
        file.write(b"%d" % number)
        return path.exists()

    file = KeptFile(path)
    assert is_there()
    path.unlink()
    wait_for(is_there, "it is made again")
    file.close()
    assert read(path) == b"%d" % number


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda path: path.mkdir(), "cannot be read: Is a directory"),
        (lambda path: path.symlink_to("elsewhere"), "cannot be read: Too many levels of symbolic"),
        (lambda path: os.mkfifo(path), "is not a regular file"),
    ],
    ids=["folder", "link", "pipe"],
)
def test_what_is_no_file_is_refused(
    tmp_path: Path, make: Callable[[Path], None], what: str
) -> None:
    make(tmp_path / "kept")
    with pytest.raises(KeepError, match=what):
        KeptFile(tmp_path / "kept")


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    file = KeptFile(tmp_path / "no" / "kept")
    with pytest.raises(KeepError, match=r"no/kept cannot be written: No such file or directory"):
        file.write(b"1")
    file.close()


def test_a_full_disk_loses_nothing_that_was_written(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    with small_disk(disk, "128k"):
        file = KeptFile(disk / "kept")
        file.write(b"first")
        (disk / "other").write_bytes(b"x" * 80_000)
        file.write(b"second")  # there is room for it already
        with pytest.raises(KeepError, match="cannot be written: No space left"):
            file.write(b"x" * 50_000)
        file.close()
        assert read(disk / "kept") == b"second"


def test_what_is_written_is_brought_to_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def latest(content: bytes) -> bytes:
        (tmp_path / "before").write_bytes(content)
        return read(tmp_path / "before") or b"0"

    synced: list[bytes] = []
    path = tmp_path / "kept"

    def note(file: int) -> None:
        if os.path.samestat(os.fstat(file), path.stat()):
            synced.append(path.read_bytes())

    file = KeptFile(path)
    file.write(b"0")
    monkeypatch.setattr(os, "fsync", note)
    monkeypatch.setattr(module, "SYNC_S", 0.01)
    file.write(b"1")
    wait_for(lambda: any(b"1" in each for each in synced))
    number = 1
    while len(synced) < 20:
        number += 1
        file.write(b"%d" % number)
        if (
            number % 50 == 0 and len(synced) > 1
        ):  # a loss of power may damage all that has changed since
            before, on_disk = synced[-2:]
            pairs, copy = zip(path.read_bytes(), on_disk, strict=True), tmp_path / "copy"
            copy.write_bytes(bytes(one if one == other else one ^ 255 for one, other in pairs))
            found = read(copy)
            assert found is not None
            assert int(found) >= int(latest(before))
    file.close()
    assert b"%d" % number in synced[-1]


def test_a_process_may_be_killed_at_any_moment(tmp_path: Path) -> None:
    chance = random.Random(0)
    path = tmp_path / "kept"
    for _ in range(examples(40)):
        ours, theirs = Pipe(duplex=False)
        pid = os.fork()
        if pid == 0:
            try:
                file = KeptFile(path)
                number = int.from_bytes((file.latest or b"")[:8], "little")
                while True:
                    number += 1
                    theirs.send_bytes(number.to_bytes(8, "little"))
                    file.write(number.to_bytes(8, "little") * chance.choice([1, 1, 1, 900]))
            finally:
                os._exit(1)
        theirs.close()
        begun = 0
        for _ in range(chance.randrange(1, 60)):
            begun = int.from_bytes(ours.recv_bytes(), "little")
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        while ours.poll():
            try:
                begun = int.from_bytes(ours.recv_bytes(), "little")
            except EOFError:
                break
        latest = read(path)
        number = 0 if latest is None else int.from_bytes(latest[:8], "little")
        assert number in (begun - 1, begun)
