"""The rows of the pages: measured in a browser, if one is installed."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from measure import Side
from table import FRAMES, MEDIANS, PERCENT, SLOWER, Row

__all__ = ["rows"]


def rows(seconds: float, edits: int) -> Iterator[Row]:
    """Show a board for so long, and edit a machine so many times in each way."""
    yield from _view(seconds)
    yield from _edit(edits)


def _view(seconds: float) -> Iterator[Row]:
    """Show 500 slots at 50 Hz and 50 machines."""
    figures, why = _figures("view.py", "--seconds", str(seconds))

    def side(who: str, name: str, times: float = 1.0) -> Side:
        return Side(who, "view.py", [figures[name] * times] if figures else [])

    yield Row("a page, frames drawn", [side("llfsm", "frames")], FRAMES, 20, why)
    yield Row("  its server, part of a core", [side("llfsm", "server", 100)], PERCENT, 25, why)
    sides = [side("llfsm", "cost_with", 1e3), side("without a page", "cost_without", 1e3)]
    yield Row("  a ringlet meanwhile", sides, SLOWER, None, why)


def _edit(times: int) -> Iterator[Row]:
    """Edit a machine of 200 states: how soon that is seen."""
    figures, why = _figures("edit.py", "--times", str(times))
    kinds = (
        ("an edit of 200 states: move one", "move", 4),
        ("  rename one", "rename", 4),
        ("  connect two", "connect", 4),
        ("  add one", "add", 4),
        ("  undo that", "undo", 4),
        ("  select one", "select", 4),
        ("  place all of them", "arrange", 16),
        ("  a finding in a typed text", "check", 25),
    )
    bare = Side("a bare copy", "cloneNode", figures.get("bare", []))
    for what, kind, most in kinds:
        ours = Side("llfsm", "edit.py", figures.get(kind, []))
        yield Row(what, [ours, bare], MEDIANS, most, why)


def _figures(name: str, *arguments: str) -> tuple[dict[str, Any], str | None]:
    """Return what a script measured, or why it could not."""
    if not shutil.which("chromium"):
        return {}, "it needs Chromium: sudo apt-get install -y chromium"
    if not importlib.util.find_spec("playwright"):
        return {}, "it needs playwright: pip install 'llfsm[bench]'"
    script = str(Path(__file__).with_name(name))
    command = [sys.executable, script, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        return {}, " ".join([f"{name} failed:", *done.stderr.splitlines()[-1:]])
    figures: dict[str, Any] = json.loads(done.stdout)
    return figures, None
