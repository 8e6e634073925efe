"""Bundles to read and run, written for each test."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

DATA = Path(__file__).parents[2] / "data" / "bundles"


@pytest.fixture
def lamp(tmp_path: Path) -> Path:
    """Give a copy of a bundle of C++ to damage."""
    return Path(shutil.copytree(DATA / "Lamp.machine", tmp_path / "Lamp.machine"))


@pytest.fixture
def bundle(tmp_path: Path) -> Callable[..., Path]:
    """Give a function that writes a bundle of Python called M, of states A and B.

    Keywords are files: `A_OnEntry` is State_A_OnEntry.py, `Variables` is M_Variables.py, and
    `expr` the expression of A's transition to B.
    """

    def write(files: Mapping[str, str] | None = None, **texts: str) -> Path:
        folder = tmp_path / "M.machine"
        folder.mkdir()
        contents = {
            "Language": "python",
            "States": "A\nB",
            "State_A_Transition_0.target": "B\n",
            "State_A_Transition_0.expr": texts.pop("expr", "stopping"),
            "State_B_OnEntry.py": "\n",
        }
        for key, text in texts.items():
            stem = "M" if key in ("Variables", "Includes", "Methods") else "State"
            contents[f"{stem}_{key}.py"] = text
        for name, text in {**contents, **(files or {})}.items():
            (folder / name).write_bytes(text.encode())
        return folder

    return write
