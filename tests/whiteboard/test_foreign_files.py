"""A file that is not a board of this user is refused and not changed."""

from __future__ import annotations

import os
import pickle
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from llfsm.whiteboard import BoardError, BoardPermissionError, BoardVersionError, Whiteboard
from llfsm.whiteboard.shared import boards

RunPython = Callable[..., str]


# ---- Another version ------------------------------------------------------------------------


def fnv1a(data: bytearray) -> int:
    value = 0xCBF29CE484222325
    for byte in data:
        value = (value ^ byte) * 0x100000001B3 % 2**64
    return value


@pytest.mark.parametrize(
    ("offset", "value"),
    [(8, 3), (8, 1), (12, 0x04030201), (16, 8192), (20, 128), (24, 8), (28, 33216 + 8)],
    ids=["version", "older", "byte order", "slots", "writers", "buffers", "header"],
)
def test_a_board_of_another_version(offset: int, value: int, tmp_path: Path) -> None:
    with Whiteboard("old", directory=tmp_path) as made:
        path = made.path
    data = bytearray(path.read_bytes())
    assert struct.unpack_from("<Q", data, 32)[0] == fnv1a(data[:32])
    struct.pack_into("<I", data, offset, value)
    struct.pack_into("<Q", data, 32, fnv1a(data[:32]))
    path.write_bytes(data)
    with pytest.raises(BoardVersionError, match=r"made by another version .* remove it with"):
        Whiteboard("old", directory=tmp_path)
    assert path.read_bytes() == data
    assert boards(tmp_path) == [("old", False)]


# ---- No board at all ------------------------------------------------------------------------


def is_folder(path: Path) -> None:
    path.mkdir()


def is_link_to_a_board(path: Path) -> None:
    Whiteboard("other", directory=path.parent).close()
    path.symlink_to("llfsm.other")


def is_dangling_link(path: Path) -> None:
    path.symlink_to("nowhere")


def is_extension(path: Path) -> None:
    _shm = pytest.importorskip("llfsm.whiteboard._shm", reason="the extension is hidden")

    shutil.copy(_shm.__file__, path)


@pytest.mark.parametrize(
    "make",
    [
        Path.touch,
        lambda path: path.write_text("a text\n"),
        is_extension,
        is_folder,
        is_link_to_a_board,
        is_dangling_link,
        os.mkfifo,
    ],
    ids=["empty", "text", "program", "folder", "link", "dangling", "fifo"],
)
@pytest.mark.parametrize("create", [True, False])
def test_another_kind_of_file(make: Callable[[Path], object], create: bool, tmp_path: Path) -> None:
    path = tmp_path / "llfsm.alien"
    make(path)
    kind, content = path.lstat().st_mode, path.read_bytes() if path.is_file() else None
    why = r"llfsm\.alien: (not a whiteboard of this user|Is a directory)"
    with pytest.raises(BoardError, match=why):
        Whiteboard("alien", directory=tmp_path, create=create)
    assert path.lstat().st_mode == kind
    assert content is None or path.read_bytes() == content
    assert not any(info.used for info in boards(tmp_path))


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make a file of another user")
def test_a_file_of_another_user(tmp_path: Path) -> None:
    Whiteboard("theirs", directory=tmp_path).close()
    os.chown(tmp_path / "llfsm.theirs", 1, 1)
    with pytest.raises(BoardPermissionError, match="another user's file"):
        Whiteboard("theirs", directory=tmp_path)
    assert boards(tmp_path) == []


MEMBER = """
import os, sys
from llfsm.whiteboard import Slot, Whiteboard, WhiteboardError
from llfsm.whiteboard.messages.std_msgs import Int32
from llfsm.whiteboard.shared import boards
NUMBER = Slot("number", Int32)
def become(uid, *groups):
    os.setresuid(0, 0, 0)
    os.setgroups(groups)
    os.setresgid(uid, uid, uid)
    os.setresuid(uid, uid, 0)
def refusal(**how):
    try:
        Whiteboard("shared", directory=".", **how).close()
    except WhiteboardError as error:
        return type(error).__name__
    return "none"
os.chdir(sys.argv[1])
os.chmod(".", 0o1777)
assert NUMBER.fingerprint  # by modules that others may not be able to import
become(20001, 30000)
board = Whiteboard("shared", directory=".", group=30000)
board.add_message(NUMBER, Int32(1))
print(oct(os.stat("llfsm.shared").st_mode & 0o777), os.stat("llfsm.shared").st_gid)
print("its owner:", refusal())
become(20002, 30000)
with Whiteboard("shared", directory=".", group=30000) as again:
    print(again.get_message(NUMBER).data)
    again.add_message(NUMBER, Int32(2))
os.environ["WHITEBOARD_GROUP"] = "30000"
print(board.get_message(NUMBER).data, [each.name for each in boards(".")])
Whiteboard("private", directory=".", group="").close()
os.chown("llfsm.private", -1, 30000)
print("private:", [each.name for each in boards(".")])
become(20003)
print("another:", refusal(), refusal(group=""), refusal(group=30001))
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become several users")
def test_a_board_of_a_group_is_for_who_is_in_it(tmp_path: Path, run_python: RunPython) -> None:
    folder = tmp_path / "shared"
    folder.mkdir()
    assert run_python(MEMBER, folder).splitlines() == [
        "0o660 30000",
        "its owner: none",
        "1",
        "2 ['shared']",
        "private: ['shared']",
        "another: BoardPermissionError BoardPermissionError BoardPermissionError",
    ]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be in any group")
@pytest.mark.parametrize("mode", [0o600, 0o666, 0o640, 0o760])
def test_a_board_of_a_group_with_another_mode_is_refused(tmp_path: Path, mode: int) -> None:
    Whiteboard("odd", directory=tmp_path, group=30000).close()
    (tmp_path / "llfsm.odd").chmod(mode)
    with pytest.raises(BoardPermissionError, match="not a whiteboard of this user"):
        Whiteboard("odd", directory=tmp_path, group=30000)


def test_a_group_that_is_none_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(BoardPermissionError, match="no group of this host is called 'robotz'"):
        Whiteboard("odd", directory=tmp_path, group="robotz")


def test_a_board_of_a_group_is_pickled_as_that(tmp_path: Path) -> None:
    with Whiteboard("own", directory=tmp_path, group=os.getegid()) as board:
        again = pickle.loads(pickle.dumps(board))
        assert again.path == board.path
        again.close()


def test_a_file_without_permission(tmp_path: Path, run_python: RunPython) -> None:
    Whiteboard("closed", directory=tmp_path).close()
    (tmp_path / "llfsm.closed").chmod(0)
    script = """
import os, sys
from llfsm.whiteboard import BoardPermissionError, Whiteboard
os.chdir(sys.argv[1])
if os.geteuid() == 0:
    os.chown("llfsm.closed", 65534, 65534)
    os.setresuid(65534, 65534, 65534)
for name in ("closed", "new"):
    try:
        Whiteboard(name, directory=".")
        if name == "new":
            os.remove("llfsm.new")
    except BoardPermissionError as error:
        print(error)
"""
    printed = run_python(script, tmp_path)
    assert "llfsm.closed: Permission denied; it belongs to another user or is protected" in printed
