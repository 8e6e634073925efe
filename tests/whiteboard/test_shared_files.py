"""The file of a shared board: its name, its making, its removal, and what tools see of it."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from llfsm.whiteboard import (
    BoardError,
    BoardNotFoundError,
    Message,
    Slot,
    SlotNameError,
    SlotNotFoundError,
    Whiteboard,
)
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.board_files import default_name, remove_board
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.std_msgs import Int64
from llfsm.whiteboard.shared import BoardInfo, boards
from llfsm.whiteboard.slot_names import KEEPS_READ

RunPython = Callable[..., str]

NUMBER = Slot("number", Int64)


@pytest.fixture
def wb(tmp_path: Path) -> Iterator[Whiteboard]:
    with Whiteboard("board", directory=tmp_path) as board:
        yield board


def test_the_default_board_is_in_shared_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"test-{os.getpid()}-default"
    monkeypatch.setenv("WHITEBOARD_NAME", name)
    assert default_name() == name
    with Whiteboard() as wb:
        try:
            assert wb.name == name
            assert wb.path == Path(f"/dev/shm/llfsm.{name}")
            assert stat.S_IMODE(wb.path.stat().st_mode) == 0o600
            assert BoardInfo(name, used=True) in boards()
        finally:
            remove_board(name)
        assert not wb.alive
    monkeypatch.delenv("WHITEBOARD_NAME")
    assert default_name() == "whiteboard"


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "a b", "-a", ".a", "é", "a" * 201, "a\n"])
def test_an_impossible_board_name(name: str, tmp_path: Path) -> None:
    with pytest.raises(SlotNameError, match="is not a valid whiteboard name: use 1 to 200 letters"):
        Whiteboard(name, directory=tmp_path)
    with pytest.raises(SlotNameError, match="is not a valid whiteboard name"):
        remove_board(name, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_board_that_is_not_there_is_not_made(tmp_path: Path) -> None:
    with pytest.raises(BoardNotFoundError, match=r"llfsm\.board: no such whiteboard"):
        Whiteboard("board", directory=tmp_path, create=False)
    with pytest.raises(BoardNotFoundError, match="the folder for whiteboards must exist"):
        Whiteboard("board", directory=tmp_path / "nowhere")
    with pytest.raises(BoardNotFoundError, match="no such whiteboard"):
        remove_board("board", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_a_long_or_odd_path(tmp_path: Path) -> None:
    for folder in (tmp_path / ("a" * 200) / ("b" * 200) / ("c" * 200), tmp_path / "\udcff"):
        folder.mkdir(parents=True)
        with Whiteboard("board", directory=folder) as wb:
            wb.add_message(NUMBER, Int64(1))
            assert boards(folder) == [("board", True)]
    with pytest.raises(BoardError, match="File name too long"):
        Whiteboard("board", directory=tmp_path / ("a" * 256))


def test_removing_what_cannot_be_removed(tmp_path: Path) -> None:
    (tmp_path / "llfsm.folder").mkdir()
    with pytest.raises(BoardError, match=r"llfsm\.folder: Is a directory"):
        remove_board("folder", tmp_path)
    with pytest.raises(BoardError, match=r"llfsm\.board: Not a directory"):
        remove_board("board", __file__)


def test_boards_are_listed_with_their_use(tmp_path: Path, run_python: RunPython) -> None:
    assert boards(tmp_path) == boards(tmp_path / "nowhere") == []
    with Whiteboard("open", directory=tmp_path):
        Whiteboard("closed", directory=tmp_path).close()
        (tmp_path / "llfsm.damaged").write_text("no board")
        (tmp_path / "llfsm.link").symlink_to("llfsm.open")
        (tmp_path / "something else").write_text("")
        listed = [("closed", False), ("damaged", False), ("open", True)]
        assert boards(tmp_path) == listed
        script = (
            "import sys\n"
            "from llfsm.whiteboard.shared import boards\n"
            "print([tuple(info) for info in boards(sys.argv[1])])\n"
        )
        assert run_python(script, tmp_path) == f"{listed}\n"
    for name in ("closed", "damaged", "open"):
        remove_board(name, tmp_path)
    assert boards(tmp_path) == []


def test_a_board_removed_while_boards_are_listed_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listed = [tmp_path / "llfsm.gone", tmp_path / "llfsm.there"]
    monkeypatch.setattr(Path, "glob", lambda *_: iter(listed))
    with Whiteboard("there", directory=tmp_path):
        assert boards(tmp_path) == [("there", True)]


def test_a_removed_board_is_dead_and_its_name_free(
    wb: Whiteboard, tmp_path: Path, run_python: RunPython
) -> None:
    wb.add_message(NUMBER, Int64(1))
    script = (
        "import sys\n"
        "from llfsm.whiteboard.board_files import remove_board\n"
        "remove_board('board', sys.argv[1])\n"
    )
    run_python(script, tmp_path)
    assert not wb.alive
    wb.add_message(NUMBER, Int64(2))  # who still has it open may go on
    assert wb.get_message(NUMBER) == Int64(2)
    with Whiteboard("board", directory=tmp_path) as successor:
        assert successor.alive
        assert successor.slots() == []
        wb.remove()  # removes nothing of its successor
        assert successor.alive
        assert successor.path.exists()


def test_a_board_whose_file_is_deleted_by_hand_is_dead(wb: Whiteboard) -> None:
    assert wb.alive
    wb.path.unlink()
    assert not wb.alive


def test_a_tool_finds_a_slot_without_its_class(wb: Whiteboard) -> None:
    wb.add_message(Slot("cmd", Twist), Twist(Vector3(1.0)))
    found = wb.find("cmd")
    assert found.type_name == "geometry_msgs/msg/Twist"
    assert repr(wb.get_message(found)) == repr(Twist(Vector3(1.0)))
    _ = wb[Slot("arm" + KEEPS_READ, Twist)]  # as who shows another host has it
    with pytest.raises(SlotNotFoundError, match=r"board 'board' has no slot 'x'; its slots: cmd$"):
        wb.find("x")


@pytest.mark.parametrize(
    "name", ["", "cmd\0", "c" * 256, "c" * 100_000, "\udcff", chr(0xD800), "é"]
)
def test_a_name_that_no_slot_has_is_not_found(wb: Whiteboard, name: str) -> None:
    wb.add_message(Slot("cmd", Twist), Twist())
    with pytest.raises(SlotNotFoundError, match="its slots: cmd"):
        wb.find(name)


def test_a_slot_is_found_until_its_name_is_given_up_to_another(wb: Whiteboard) -> None:
    before = "none"
    for name in ("é", "a.b/c", "c" * 255):
        wb.add_message(Slot(name, Twist), Twist())
        assert wb.find(name).name == name
        with pytest.raises(SlotNotFoundError):
            wb.find(before)
        wb.vacate(Slot(name, Twist))
        before = name


def test_finding_a_slot_does_not_list_all(tmp_path: Path) -> None:
    """A daemon finds each of up to 4096 when it starts."""

    class Unlisted(Whiteboard):
        def slots(self) -> list[SlotInfo]:
            raise AssertionError

    with Unlisted("board", directory=tmp_path) as wb:
        wb.add_message(Slot("cmd", Twist), Twist())
        assert wb.find("cmd").name == "cmd"


class Twice(Message, type_name="std_msgs/msg/Int64"):
    data: str = ""


def test_the_type_of_another_handle_binds(wb: Whiteboard, tmp_path: Path) -> None:
    with Whiteboard("board", directory=tmp_path) as other:
        other.add_message(NUMBER, Int64(5))
        with pytest.raises(TypeError, match=r"data is type:integer.* on the board, type:string in"):
            wb[Slot("number", Twice)]
        assert wb.get_message(NUMBER) == Int64(5)
