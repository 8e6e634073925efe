"""Bundles to edit: one with names and files that are easily confused, and one without a layout."""

from __future__ import annotations

from pathlib import Path

import pytest

MACHINES = Path(__file__).parents[3] / "machines"
DATA = Path(__file__).parents[2] / "data" / "bundles"

# One state's name begins with another's, one is called as a part of a machine is, the last line
# has no end, and there are files of a state and of a transition that nothing lists.
CONFUSING = {
    "Language": b"python\r\n",
    "States": b"Done\r\nDone_Suspending\r\nVariables\r\nOnEntry",
    "SuspendState": b"Done_Suspending\n",
    "M_Variables.py": b"\xef\xbb\xbfcount: int = 0  # how many\r\n",
    "State_Done_OnEntry.py": b"count += 1\r\n# a comment\r\n",
    "State_Done_Transition_0.target": b"  Variables \r\n",
    "State_Done_Transition_0.expr": b"count > 3  # enough\r\n",
    "State_Done_Transition_1.target": b"Done_Suspending",
    "State_Done_Transition_2.target": b"Done\n",
    "State_Done_Transition_2.expr": b"stopping",
    "State_Done_Suspending_OnExit.py": b"pass",
    "State_Variables_Variables.py": b"own: float = 0.5\n",
    "State_Variables_Transition_0.target": b"OnEntry\n",
    "State_OnEntry_OnEntry.py": b"\n",
    "State_Gone_OnEntry.py": b"left = 1\n",
    "notes.txt": b"\xff\x00 not text",
    "State_Done.mm": b"// kept\n",
}


def files_in(folder: Path) -> dict[str, bytes]:
    """Return every file in a folder, hidden ones too."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def write(folder: Path, files: dict[str, bytes]) -> Path:
    folder.mkdir()
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


@pytest.fixture
def confusing(tmp_path: Path) -> Path:
    return write(tmp_path / "M.machine", CONFUSING)
