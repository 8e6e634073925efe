"""A line of a file stands for all that is declared there, in any of Python's forms."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from llfsm.cli.dap.inspection import breakpoints_at

CODE = """
from llfsm.runtime import Machine, State

class Base(Machine):
    n: int = 0
    a, b = State(), State()  # a b
    c = State("SEE")  # SEE
    d: State = State()  # d

    @c.to(d)
    @a.to(d)
    def shared(self) -> bool:  # SEE->d a->d
        return self.n == 3  # SEE->d a->d

    @a.on_entry
    @b.on_entry
    def both(self) -> None:  # a b
        self.n += 1  # a b

    a.to(b, when=lambda self: self.n == 1); b.to(a, when=lambda self: self.n == 2)  # a->b b->a

    @d.on_exit
    def bye(self) -> None:
        self.n = 4  # d->

    for state in (a, b):
        state.to(c)  # a->SEE b->SEE

    e = State(); f = State()  # e f
    d.to(e)
    e.to(f)


class Loop(Base):
    '''Inherit all of it.'''
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    file = tmp_path / "places.py"
    file.write_text(CODE)
    spec = importlib.util.spec_from_file_location("places", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "places", module)
    spec.loader.exec_module(module)
    return file


@pytest.mark.parametrize("name", ["Base", "Loop"])
def test_each_line_has_all_of_its_places(file: Path, name: str) -> None:
    machines = {name: getattr(sys.modules["places"], name)}
    for line, text in enumerate(CODE.splitlines(), 1):
        _, marked, places = text.partition("  # ")
        if marked:
            found = {each.breakpoint for each in breakpoints_at(machines, str(file), line)}
            assert found == {f"{name}:{place}" for place in places.split()}, text
