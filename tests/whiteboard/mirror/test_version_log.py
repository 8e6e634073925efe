"""The log of versions that a daemon leaves to the next one of its board."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from llfsm.whiteboard import BoardMirroredError, BoardPermissionError, Whiteboard
from llfsm.whiteboard.board_files import remove_board, version_log_path
from llfsm.whiteboard.mirror.batches import Version
from llfsm.whiteboard.mirror.store import FileVersionLog


@pytest.fixture
def board(tmp_path: Path) -> Path:
    Whiteboard("board", directory=tmp_path).close()
    return tmp_path / "llfsm.board"


def test_a_version_is_recalled_by_number_and_writer(board: Path) -> None:
    journal = FileVersionLog(board)
    journal.note("slot", 1, 10, Version(100, 1))
    journal.note("slot", 2, 11, Version(200, 2))
    host = journal.host
    journal.close()
    journal = FileVersionLog(board)
    assert journal.host == host
    assert journal.recall("slot", 2, 11) == (Version(200, 2), Version(100, 1))
    assert journal.recall("slot", 2, 10) == (None, Version(100, 1))
    assert journal.recall("slot", 3, 10) == (None, Version(200, 2))
    assert journal.recall("other", 1, 10) == (None, None)
    journal.note("slot", 3, 10, Version(300, 1))  # in place of the older one
    assert journal.recall("slot", 1, 10) == (None, None)
    journal.close()


@pytest.mark.parametrize("ending", ["z", "zz", "é", "aé", "éa"])
@pytest.mark.parametrize("length", [253, 254, 255])
def test_a_name_of_any_length_is_whole(board: Path, ending: str, length: int) -> None:
    """Also one of 255 bytes, as long as a board takes, whose last letter has two."""
    name = "a" * (length - len(ending.encode())) + ending
    journal = FileVersionLog(board)
    journal.note(name, 1, 10, Version(100, 1))
    host = journal.host
    journal.close()
    journal = FileVersionLog(board)
    assert journal.host == host
    assert journal.recall(name, 1, 10)[0] == Version(100, 1)
    journal.close()


def test_an_entry_that_was_half_written_is_none(board: Path) -> None:
    journal = FileVersionLog(board)
    journal.note("slot", 1, 10, Version(100, 1))
    journal.note("slot", 2, 10, Version(200, 1))
    journal.close()
    path = version_log_path(board)
    data = bytearray(path.read_bytes())
    at = data.index((200).to_bytes(8, "little"))
    data[at] ^= 1
    path.write_bytes(data)
    journal = FileVersionLog(board)
    assert journal.recall("slot", 2, 10) == (None, Version(100, 1))
    journal.close()


def test_all_slots_of_a_board_have_room(board: Path) -> None:
    journal = FileVersionLog(board)
    names = [f"{'ä' * 120}{i}" for i in range(4096)]
    for i, name in enumerate(names):
        journal.note(name, 1, 1, Version(i, 1))
    journal.close()
    journal = FileVersionLog(board)
    assert [journal.recall(name, 1, 1)[0] for name in names] == [Version(i, 1) for i in range(4096)]
    journal.close()


def test_a_journal_of_another_board_of_that_name_is_forgotten(tmp_path: Path, board: Path) -> None:
    journal = FileVersionLog(board)
    journal.note("slot", 1, 10, Version(100, 1))
    journal.close()
    kept = tmp_path / "kept"
    board.rename(kept)  # so that its inode is not used again
    Whiteboard("board", directory=tmp_path).close()
    again = FileVersionLog(board)
    assert again.recall("slot", 1, 10) == (None, None)
    assert again.host != journal.host
    again.close()


def test_one_holds_it_at_a_time(board: Path) -> None:
    journal = FileVersionLog(board)
    with pytest.raises(BoardMirroredError, match="another daemon mirrors this whiteboard"):
        FileVersionLog(board)
    journal.close()
    FileVersionLog(board).close()


def test_it_goes_with_its_board(board: Path) -> None:
    FileVersionLog(board).close()
    assert version_log_path(board).exists()
    remove_board("board", board.parent)
    assert list(board.parent.iterdir()) == []


def test_a_journal_of_another_owner_is_refused(board: Path) -> None:
    """Another user may have put it there, to write versions into it or to hold its lock."""
    if os.geteuid() != 0:
        pytest.skip("only root can give a file away")
    FileVersionLog(board).close()
    path = version_log_path(board)
    before = path.read_bytes()
    os.chown(path, 12345, -1)
    with pytest.raises(BoardPermissionError, match="belongs to another user"):
        FileVersionLog(board)
    assert path.read_bytes() == before


def test_another_kind_of_file_in_its_place_is_refused(board: Path) -> None:
    os.mkfifo(version_log_path(board))
    with pytest.raises(BoardPermissionError, match="not a regular file"):
        FileVersionLog(board)


def test_a_damaged_journal_is_begun_anew(board: Path) -> None:
    journal = FileVersionLog(board)
    journal.note("slot", 1, 10, Version(100, 1))
    journal.close()
    path = version_log_path(board)
    whole = path.read_bytes()
    name, host = whole.index(b"slot"), 24
    for at, damage in ((name, b"\xff"), (name - 2, b"\xff\xff"), (host, b"\xff" * 8)):
        path.write_bytes(whole[:at] + damage + whole[at + len(damage) :])
        again = FileVersionLog(board)
        assert again.recall("slot", 1, 10) == (None, None)
        assert again.host < 1 << 63
        again.note("slot", 2, 10, Version(200, 1))
        again.close()
        again = FileVersionLog(board)
        assert again.recall("slot", 2, 10) == (Version(200, 1), None)
        again.close()


def test_a_link_in_its_place_is_not_followed(tmp_path: Path, board: Path) -> None:
    (tmp_path / "precious").write_text("keep")
    version_log_path(board).symlink_to(tmp_path / "precious")
    with pytest.raises(Exception, match="Too many levels of symbolic links"):
        FileVersionLog(board)
    assert (tmp_path / "precious").read_text() == "keep"


def test_names_that_are_gone_leave_their_room_to_others(board: Path) -> None:
    living: set[str] = set()
    journal = FileVersionLog(board, lambda: living)
    for number in range(3 * 4096):
        living = {f"kept{n}" for n in range(3)} | {f"job{n}" for n in range(number - 50, number)}
        if number % 1000 < 3:
            journal.note(f"kept{number % 1000}", 1, 1, Version(number + 1, 1))
        journal.note(f"job{number}", 1, 1, Version(number + 1, 1))
    expected = {name: journal.recall(name, 1, 1)[0] for name in living}
    assert None not in {expected[name] for name in living if name != f"job{number}"}
    journal.close()
    again = FileVersionLog(board, lambda: living)
    assert {name: again.recall(name, 1, 1)[0] for name in living} == expected
    again.note("job1", 1, 1, Version(7, 1))
    again.note("job2", 2, 1, Version(8, 1))
    assert (again.recall("job1", 1, 1)[0], again.recall("job2", 2, 1)[0]) == (
        Version(7, 1),
        Version(8, 1),
    )
    assert {name: again.recall(name, 1, 1)[0] for name in living} == expected
    again.close()


def test_a_name_that_comes_again_has_one_record(board: Path) -> None:
    living = {"b"}
    journal = FileVersionLog(board, lambda: living)
    for number in range(4096):
        journal.note(f"a{number}", 1, 1, Version(1, 1))
    journal.note("b", 1, 1, Version(2, 1))
    journal.note("a5", 1, 1, Version(3, 1))
    journal.close()
    for _ in range(3):
        journal = FileVersionLog(board, lambda: living)
        for number in range(100):
            journal.note(f"c{number}", 1, 1, Version(number + 1, 2))
        assert journal.recall("b", 1, 1)[0] == Version(2, 1)
        assert journal.recall("c7", 1, 1)[0] == Version(8, 2)
        journal.close()
