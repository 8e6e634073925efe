"""``llfsm show``: the variables, states and transitions of a machine, as text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import click

from llfsm.cli.echo import echo
from llfsm.cli.machines import find_bundle, find_machine_class
from llfsm.runtime.bundles import Bundle, Fragment, read_bundle
from llfsm.runtime.bundles.cpp import without_comments
from llfsm.runtime.converting.class_process import declared_lines
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.source_text import body_of
from llfsm.runtime.engine.table import run_names


class _Shown(NamedTuple):
    """A state to show: its sections' texts, and its transitions as (target, label)."""

    name: str
    declarations: list[str]
    sections: Mapping[str, str]
    transitions: list[tuple[str, str]]
    accepting: bool


@click.command()
@click.argument("machine")
def show(machine: str) -> None:
    """Show the variables, states and transitions of MACHINE, a name or a bundle.

    MACHINE may be a bundle of C++.

    \b
    llfsm show RosWallTurttleBot
    llfsm show path/to/Patrol.machine
    """
    folder = find_bundle(machine)
    lines = (
        _of_class(find_machine_class(machine))
        if folder is None
        else _of_bundle(read_bundle(folder))
    )
    for line in lines:
        echo(line)


def _of_bundle(bundle: Bundle) -> Iterator[str]:
    yield f"{bundle.name}: {_count(len(bundle.states))}, bundle of {bundle.language}"
    yield from _indented(_declared(bundle.variables))
    states = [
        _Shown(
            state.name,
            [*_runs(state.runs), *_declared(state.variables)],
            {name: fragment.text for name, fragment in state.sections.items()},
            [(each.target, _label(each.expression)) for each in state.transitions],
            state.accepting,
        )
        for state in bundle.states
    ]
    yield from _states(states, bundle.suspend)


def _of_class(cls: type[Machine]) -> Iterator[str]:
    table = cls.table
    yield f"{cls.__name__}: {_count(len(table.states))}, class {table.path}"
    yield from _indented(declared_lines(table))
    states = [
        _Shown(
            state.name,
            _runs(run_names(state)),
            {name: body_of(code) or repr(code) for name, code in state.sections.items()},
            [(each.target.name, each.label) for each in state.transitions],
            state.accepting,
        )
        for state in table.states
    ]
    yield from _states(states, table.suspend.name if table.suspend else None)


def _states(states: list[_Shown], suspend: str | None) -> Iterator[str]:
    """Yield the lines of each state; `suspend` is the name of the suspend state."""
    for state in states:
        marks = {
            "initial": state is states[0],
            "suspend": state.name == suspend,
            "accepting": state.accepting,
        }
        marked = ", ".join(mark for mark, holds in marks.items() if holds)
        yield ""
        yield f"{state.name} ({marked})" if marked else state.name
        yield from _indented(state.declarations)
        for section, text in state.sections.items():
            if code := [line for line in text.splitlines() if line.strip(" \t{}")]:
                more = f"  (and {len(code) - 1} more)" if len(code) > 1 else ""
                yield f"  {section:<9} {code[0].strip()}{more}"
        width = max((len(target) for target, _ in state.transitions), default=0)
        for target, label in state.transitions:
            yield f"  -> {target:<{width}}  {label}"


def _runs(names: Iterable[str]) -> list[str]:
    text = ", ".join(names)
    return [f"runs {text}"] if text else []


def _declared(fragment: Fragment | None) -> list[str]:
    """Return the lines of a fragment that declare something."""
    if fragment is None:
        return []
    cpp = fragment.file is not None and fragment.file.suffix != ".py"
    return [
        " ".join(line.split())
        for line, bare in zip(
            fragment.text.split("\n"),
            (without_comments(fragment.text) if cpp else fragment.text).split("\n"),
            strict=True,
        )
        if bare.strip() and (cpp or bare.lstrip()[0] != "#")
    ]


def _label(expression: Fragment | None) -> str:
    return "true" if expression is None else " ".join(expression.text.split())


def _indented(lines: Iterable[str]) -> Iterator[str]:
    return (f"  {line}" for line in lines)


def _count(states: int) -> str:
    return "1 state" if states == 1 else f"{states} states"
