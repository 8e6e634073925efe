"""Count the states of a model in Promela with SPIN."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from pathlib import Path

from programs import program

__all__ = ["count"]

# Write-only variables are part of a state, and every state is looked at.
_TRANSLATE = ("-o2", "-a")
_COMPILE = ("-w", "-O0", "-DSAFETY", "-DNOREDUCE")


def count(model: Path, folder: Path, **definitions: int) -> tuple[int, int]:
    """Return the numbers of states and transitions; skip the test if SPIN is not installed.

    SPIN counts coming to the initial state as a transition; here it is none.
    """
    spin = program("spin")
    defined = [f"-D{name}={value}" for name, value in definitions.items()]
    compiler = shlex.split(os.environ.get("CC", "cc"))
    _run([spin, *defined, *_TRANSLATE, str(model)], folder)
    _run([*compiler, *_COMPILE, "pan.c", "-o", "pan"], folder)
    report = _run(["./pan", "-m10000000"], folder)
    states, transitions = (
        int(found)
        for found in re.findall(r"^ *(\d+) (?:states, stored|transitions)", report, re.MULTILINE)
    )
    return states, transitions - 1


def _run(command: list[str], folder: Path) -> str:
    done = subprocess.run(
        command, cwd=folder, text=True, capture_output=True, timeout=100, check=True
    )
    return done.stdout
