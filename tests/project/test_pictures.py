"""The pictures in the documents show what the code does."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_each_picture_is_what_is_drawn_now() -> None:
    """After a change: make pictures."""
    pytest.importorskip("pymunk", reason="needs pymunk: pip install 'llfsm[examples]'")
    drawn = runpy.run_path(str(ROOT / ".ci" / "pictures.py"))["pictures"]()
    folder = ROOT / "docs" / "pictures"
    assert drawn == {path.name: path.read_text() for path in folder.iterdir()}
