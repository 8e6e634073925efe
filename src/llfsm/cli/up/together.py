"""The machines of a system together: what is wrong with them though each arrangement is right.

Processes that meet on a board share its slots and see each other's machines. So the machines that
they run are looked at as if one arrangement had them, but for what is wrong with one alone.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir
from pathlib import Path
from typing import NamedTuple

import click

from llfsm.cli.machines import ResolvedPlan, parse_arguments
from llfsm.cli.run.command import run
from llfsm.cli.up.system import read_systems
from llfsm.errors import LlfsmError
from llfsm.runtime.checking import Finding, check_arrangement
from llfsm.runtime.engine.environment import BoardEnvironment
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.plans import Plan, PlannedMachine, line_of
from llfsm.whiteboard import Whiteboard


class Part(NamedTuple):
    """A process that runs machines: these, and their arrangement file if they have one."""

    name: str
    folder: Path
    file: Path | None
    resolved: ResolvedPlan


def check_system(
    file: Path, check_alone: Callable[[Part, frozenset[str]], list[Finding]]
) -> list[Finding]:
    """Check the machines of a system's file, those of each process alone and then together.

    `check_alone` is called with each process, in its folder, and the names of all machines that are
    on its board.
    """
    text, here = file.read_text(encoding="utf-8"), str(file.absolute())
    found: list[Finding] = []
    boards: defaultdict[str | None, list[Part]] = defaultdict(list)
    for plan in read_systems([file]):
        if plan.run_arguments is None:
            continue
        try:
            with chdir(plan.folder):
                part = Part(plan.planned.name, plan.folder, *_resolved(plan.run_arguments))
        except (LlfsmError, click.ClickException) as error:
            why = error.message if isinstance(error, click.ClickException) else str(error)
            line = line_of(text, ("process", plan.number)) or 1
            found.append(Finding(here, line, "error", f"{plan.planned.name}: {why}"))
        else:
            boards[plan.board_name].append(part)
    for parts in boards.values():
        names = frozenset(name for part in parts for name in part.resolved.classes)
        for part in parts:
            with chdir(part.folder):
                found += check_alone(part, names)
        found += _check_together(file.absolute(), parts)
    return found


def _resolved(arguments: Sequence[str]) -> tuple[Path | None, ResolvedPlan]:
    """Find the machines of the arguments of `llfsm run`, and their file if it is one."""
    given = run.make_context("llfsm run", [*arguments]).params
    machines, table = given["machines"], given["table"]
    resolved = parse_arguments(machines, table, given["suspended"], given["preloaded"])
    files = [Path(name).absolute() for name in machines if name.endswith(".toml")]
    return next(iter(files), None), resolved


def _check_together(file: Path, parts: Sequence[Part]) -> Iterator[Finding]:
    """Check the machines of processes that meet on a board."""
    board = Whiteboard.local()
    for part in parts:
        try:
            part.resolved.assemble(BoardEnvironment(board))  # loaded, but never given a turn
        except LlfsmError as error:
            yield Finding(str(file), 1, "error", f"{part.name}: {error}")
            return
    alone = {each for part in parts for each in _findings(file, [part])}
    yield from (each for each in _findings(file, parts) if each not in alone)


def _findings(file: Path, parts: Sequence[Part]) -> list[Finding]:
    machines: list[PlannedMachine] = []
    classes: dict[str, type[Machine]] = {}
    for part in parts:
        planned = zip(part.resolved.classes.items(), part.resolved.plan.machines, strict=True)
        for (name, cls), machine in planned:
            classes[name if name not in classes else f"{name} of {part.name}"] = cls
            machines.append(machine)
    return check_arrangement(file, Plan(machines=tuple(machines)), classes)
