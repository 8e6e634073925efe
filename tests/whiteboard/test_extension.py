"""The extension of the whiteboard serves all Pythons, and can be missing."""

from __future__ import annotations

import sysconfig
from collections.abc import Callable
from pathlib import Path

import pytest

from llfsm.whiteboard import Message

_shm = pytest.importorskip("llfsm.whiteboard._shm", reason="the extension is hidden")

RunPython = Callable[..., str]


@pytest.mark.skipif(
    bool(sysconfig.get_config_var("Py_GIL_DISABLED")), reason="has no stable interface"
)
def test_it_is_one_for_all_pythons() -> None:
    assert Path(_shm.__file__).name == "_shm.abi3.so"


class Loose(Message, dict=True):
    """A class whose instances keep whatever they are given, but not all of it as fields."""

    count: int = 0


def test_a_field_without_a_place_is_refused(tmp_path: Path) -> None:
    """Otherwise its check would read what is elsewhere in memory."""
    core = _shm.Board(str(tmp_path / "board"), True, -1)
    fields = tuple((name, 1, 0, 9, None, ()) for name in ("count", "other"))
    with pytest.raises(TypeError, match="Loose'> keeps no field other"):
        _shm.Port(core, "a", "T", "{}", 1, 64, Loose, fields, lambda *_: None, lambda _: Loose())
    with pytest.raises(AttributeError, match="no attribute 'count'"):
        _shm.Port(core, "a", "T", "{}", 1, 64, Message, fields, lambda *_: None, lambda _: Loose())


def test_without_the_extension_only_the_local_board_works(run_python: RunPython) -> None:
    script = """
import sys
sys.modules["llfsm.whiteboard._shm"] = None
from llfsm.whiteboard import SharedMemoryUnavailableError, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64
try:
    Whiteboard("board")
except SharedMemoryUnavailableError as error:
    print(error)
with Whiteboard.local() as board:
    board.add_message(Slot("a", Int64), Int64(5))
    print(board.get_message(Slot("a", Int64)))
"""
    error, message = run_python(script).splitlines()
    assert "has no shared memory" in error
    assert "use Whiteboard.local()" in error
    assert message == "Int64(data=5)"
