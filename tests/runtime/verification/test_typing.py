"""What type checkers say about a user's project with its proof."""

from __future__ import annotations

import inspect
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import get_type_hints

import pytest

from llfsm.runtime.verification import Property, PropertyError, every, explore, never, verify
from llfsm.runtime.verification._exploring import ExploreOptions

HERE = Path(__file__).parent / "typed"
ROOT = Path(__file__).parents[3]
_CHECKERS = {
    "mypy": [sys.executable, "-m", "mypy", "--strict"],
    "pyright": [sys.executable, "-m", "pyright", "--pythonpath", sys.executable],
}


@pytest.fixture(scope="module", params=[*_CHECKERS])
def wrong(request: pytest.FixtureRequest) -> set[tuple[str, int]]:
    """Return the files and lines that a type checker finds wrong."""
    files = [str(HERE / name) for name in ("boiler.py", "bad.py")]
    done = subprocess.run(
        [*_CHECKERS[request.param], *files],
        cwd=ROOT,
        env={**os.environ, "MYPYPATH": str(HERE)},
        capture_output=True,
        text=True,
        check=False,
    )
    found = re.findall(r"([a-z]+\.py):(\d+)(?::\d+)?(?: -)?:? error", done.stdout)
    return {(file, int(line)) for file, line in found}


def test_each_mistake_is_found_and_nothing_else(wrong: set[tuple[str, int]]) -> None:
    lines = (HERE / "bad.py").read_text().splitlines()
    marked = {n for n, line in enumerate(lines, 1) if line.endswith("# wrong")}
    assert wrong == {("bad.py", number) for number in marked}


def test_the_project_runs() -> None:
    boiler = runpy.run_path(str(HERE / "boiler.py"))
    assert boiler["every"](boiler["Water"]) == every(boiler["Water"])


def test_verify_takes_the_options_of_explore() -> None:
    taken = inspect.signature(explore).parameters
    options = get_type_hints(ExploreOptions, vars(sys.modules[explore.__module__]), _names())
    assert [*options] == [name for name in taken if name not in ("machines", "properties")]
    hints = get_type_hints(explore, vars(sys.modules[explore.__module__]), _names())
    assert options == {name: hints[name] for name in options}


def _names() -> dict[str, object]:
    """Return the names that only type checkers import."""
    from llfsm.runtime.engine.kernel import Factory, OnError
    from llfsm.runtime.engine.machine import Machine
    from llfsm.whiteboard import Slot

    return {"Factory": Factory, "Machine": Machine, "OnError": OnError, "Slot": Slot}


def test_properties_are_given_in_either_way() -> None:
    boiler = runpy.run_path(str(HERE / "boiler.py"))
    never_on: Property = never(lambda v: v["heat"].on, "never on")
    for given, more in (([never_on], {}), ([], {"properties": [never_on]})):
        with pytest.raises(PropertyError, match="never on: violated"):
            verify(boiler["Boiler"], *given, any_time=True, **more)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="period"):
        verify(boiler["Boiler"], period=3)  # type: ignore[call-arg]
