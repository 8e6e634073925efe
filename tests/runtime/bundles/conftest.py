"""Bundles to read and run, written for each test."""

from __future__ import annotations

import plistlib
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from llfsm.runtime import Arrangement, ManualClock
from llfsm.runtime.bundles import load_bundle

DATA = Path(__file__).parents[2] / "data" / "bundles"
Write = Callable[..., Path]


def run(folder: Path, rounds: int = 1, **variables: Any) -> Any:
    """Run a bundle of Python for some rounds, and return its machine."""
    machine: Any = load_bundle(folder)(**variables)
    arrangement = Arrangement([machine], clock=ManualClock())
    for _ in range(rounds):
        arrangement.round()
    return machine


@pytest.fixture
def lamp(tmp_path: Path) -> Path:
    """Give a copy of a bundle of C++ to damage."""
    return Path(shutil.copytree(DATA / "Lamp.machine", tmp_path / "Lamp.machine"))


@pytest.fixture
def bundle(tmp_path: Path) -> Write:
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


class CppWriter:
    """Write C++ bundles as the editors do: the targets in headers, or in the newer way."""

    def __init__(self, folder: Path):
        self.folder = folder

    def __call__(
        self,
        arcs: Iterable[tuple[int, int, str | None]],
        states: Sequence[str] = ("A", "B"),
        *,
        suspend: int | None = None,
        newer: bool = False,
        files: Mapping[str, str] | None = None,
        layout: Mapping[str, object] | None = None,
        name: str = "M",
    ) -> Path:
        """Write a bundle of `states` with transitions (source, target, expression)."""
        folder = self.folder / f"{name}.machine"
        folder.mkdir()
        suspended = "" if suspend is None else f"setSuspendState(_states[{suspend}]);"
        texts = {"States": "\n".join(states), f"{name}.mm": f"{name}::{name}() {{ {suspended} }}\n"}
        for number, state in enumerate(states):
            own = [arc for arc in arcs if arc[0] == number]
            header, code = f"class {state}: public CLState {{\n", ""
            for i, (_, target, expression) in enumerate(own):
                given = "int toState" if newer else f"int toState = {target}"
                header += f"class Transition_{i} {{ Transition_{i}({given}); }};\n"
                code += f"_transitions[{i}] = new Transition_{i}({target if newer else ''});\n"
                if expression is not None:
                    texts[f"State_{state}_Transition_{i}.expr"] = expression
            header += f"virtual int numberOfTransitions() const {{ return {len(own)}; }} }};\n"
            texts |= {f"State_{state}.h": header, f"State_{state}.mm": code}
        for file, text in {**texts, **(files or {})}.items():
            (folder / file).write_bytes(text.encode())
        if layout is not None:
            (folder / "Layout.plist").write_bytes(plistlib.dumps({"States": layout}))
        return folder


@pytest.fixture
def cpp_bundle(tmp_path: Path) -> CppWriter:
    return CppWriter(tmp_path)
