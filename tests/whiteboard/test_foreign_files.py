"""A file that is not a board of this user is refused and not changed."""

from __future__ import annotations

import os
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
