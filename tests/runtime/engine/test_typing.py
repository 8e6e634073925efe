"""What type checkers and linters say about user code."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
pytest.importorskip("mypy")


@pytest.fixture(scope="module")
def report() -> list[str]:
    files = [str(HERE / "typed" / name) for name in ("good.py", "bad.py")]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", *files],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    return [line for line in done.stdout.splitlines() if ": error: " in line]


def test_good_code_passes(report: list[str]):
    assert [line for line in report if "bad.py" not in line] == []


def test_good_code_runs():
    runpy.run_path(str(HERE / "typed" / "good.py"))


def test_each_mistake_is_found_and_nothing_else(report: list[str]):
    lines = (HERE / "typed" / "bad.py").read_text().splitlines()
    wrong = {number for number, line in enumerate(lines, 1) if line.endswith("# wrong")}
    found = {int(line.split(":")[1]) for line in report if "bad.py" in line}
    assert found == wrong


def test_ruff_has_nothing_against_good_code():
    done = subprocess.run(
        [sys.executable, "-m", "ruff", "check", "--no-cache", str(HERE / "typed" / "good.py")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
