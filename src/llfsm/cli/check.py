"""``llfsm check``: find mistakes in machines, as far as their text shows them."""

from __future__ import annotations

import tomllib
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from llfsm.cli.echo import echo
from llfsm.cli.machines import (
    MachineImportError,
    find_bundle,
    find_machine_class,
    parse_arguments,
    search_modules_in,
)
from llfsm.errors import LlfsmError, did_you_mean
from llfsm.runtime.checking import (
    Finding,
    check_arrangement,
    check_bundle,
    check_class,
    check_types,
)
from llfsm.runtime.debugging.breakpoints import callable_machines
from llfsm.runtime.engine.environment import BoardEnvironment
from llfsm.runtime.engine.errors import FsmError, UnreachableStateWarning
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.plans import Plan, Verification, line_of, read_plan
from llfsm.whiteboard import Whiteboard

if TYPE_CHECKING:
    from llfsm.cli.up.together import Part


@click.command()
@click.argument("machines", nargs=-1, required=True, metavar="MACHINE...")
@click.option("--types", is_flag=True, help="Also run mypy or pyright, whichever is installed.")
@click.option(
    "--explain", is_flag=True, help="Also print what each state waits for, or why it is polled."
)
def check(machines: tuple[str, ...], types: bool, explain: bool) -> None:
    """Check each MACHINE: one that ships, patrol.py:Patrol, a bundle, or a file for run or up.

    Print a line for each finding: FILE:LINE: error or warning: what is wrong. The exit status is 1
    if there is an error. Sections and expressions are read, never run.

    \b
    llfsm check RosWallTurttleBot
    llfsm check patrol.py Lamp.machine
    llfsm check robot.toml
    llfsm check --types patrol.py
    llfsm check --explain Patrol
    """
    systems = [name for name in machines if name.endswith(".toml") and _is_system(Path(name))]
    if systems and (types or explain):
        raise click.UsageError(
            f"{systems[0]} starts processes: name their machines for --types and --explain"
        )
    found = set()
    for name in machines:
        found.update(_check_file(Path(name)) if name.endswith(".toml") else _check_machine(name))
    if types:
        found.update(check_types(_readable(machines)))
    findings = sorted(found)
    for file, line, severity, text in findings:
        echo(f"{_shown(file)}:{line}: {severity}: {text}")
    if not findings:
        echo("no findings")
    if any(finding.severity == "error" for finding in findings):
        raise click.exceptions.Exit(1)
    if explain:
        _explain(machines)


def _explain(machines: Sequence[str]) -> None:
    """Print for each state of the machines what it waits for, or why it is polled."""
    from llfsm.runtime.bundles import load_bundle  # here, as few ask
    from llfsm.runtime.expressions.waiting import waiting_text

    for each in _readable(machines):
        machine = load_bundle(each) if isinstance(each, Path) else each
        echo(machine.__name__)
        width = max(len(state.name) for state in machine.table.states)
        for state in machine.table.states:
            echo(f"  {state.name:<{width}}  {waiting_text(machine.table, state)}")


def _check_file(file: Path, known: frozenset[str] = frozenset()) -> list[Finding]:
    """Check the machines of an arrangement file, or of a system's, then what they are together.

    `known` are the names of machines that other processes run.
    """
    if _is_system(file):
        from llfsm.cli.up.together import check_system  # as few ask

        return check_system(file, _check_part)
    try:
        found = [each for machine in _planned(file) for each in _check_machine(*machine)]
    except click.UsageError as error:  # there is no such machine
        return [Finding(str(file.absolute()), 1, "error", error.message)]
    if any(each.severity == "error" for each in found):
        return found
    resolved = parse_arguments([str(file)])
    try:
        environment = BoardEnvironment(Whiteboard.local())  # loaded, but never given a turn
        resolved.assemble(environment)
    except FsmError as error:
        return [*found, Finding(str(file.absolute()), 1, "error", str(error))]
    found += _check_verification(file, resolved.plan, {*resolved.classes})
    called = callable_machines(resolved.classes) if resolved.plan.breakpoints else {}
    together = check_arrangement(
        file.absolute(), resolved.plan, resolved.classes, called, known=known
    )
    return found + together


def _is_system(file: Path) -> bool:
    with suppress(OSError, ValueError, RecursionError):  # which reading it as a plan reports
        return "process" in tomllib.loads(file.read_text(encoding="utf-8"))
    return False


def _check_part(part: Part, known: frozenset[str]) -> list[Finding]:
    """Check the machines that a process of a system runs; `known` are those of all."""
    if part.file is not None:
        return _check_file(part.file, known)
    return [
        each
        for machine in part.resolved.plan.machines
        for each in _check_machine(machine.definition, part.resolved.folders)
    ]


def _check_verification(file: Path, plan: Plan, machines: set[str]) -> list[Finding]:
    """Check the section on verification of a file: names and domains, not the properties."""
    if plan.verify is None:
        return []
    from llfsm.cli.verify import VerifiedMachines  # which takes a moment to import

    what = [
        f"[verify] suspend: no machine {name!r}; there are: {', '.join(sorted(machines))}"
        f"{did_you_mean(name, machines)}"
        for name in plan.verify.suspend
        if name not in machines
    ]
    try:
        VerifiedMachines([str(file)], Verification()).options()
    except (LlfsmError, click.UsageError) as error:
        what.append(error.message if isinstance(error, click.UsageError) else str(error))
    line = line_of(file.read_text(encoding="utf-8"), ("verify",)) or 1
    return [Finding(str(file.absolute()), line, "error", each) for each in what]


def _planned(file: Path) -> list[tuple[str, tuple[Path, ...]]]:
    """Return the definitions that an arrangement file names, and the folders to find them in."""
    folders = (file.absolute().parent, Path())
    return [(name, folders) for name in {each.definition for each in read_plan(file).machines}]


def _readable(names: Sequence[str]) -> Iterator[Path | type[Machine]]:
    """Give the machines that can be read; why others cannot was found before."""
    for name in names:
        planned = _planned(Path(name)) if name.endswith(".toml") else [(name, (Path(),))]
        for definition, folders in planned:
            with suppress(MachineImportError, click.UsageError):
                yield find_bundle(definition, folders) or find_machine_class(definition, folders)


def _check_machine(name: str, folders: Sequence[Path] = (Path(),)) -> list[Finding]:
    search_modules_in(folders)
    bundle = find_bundle(name, folders)
    if bundle is not None:
        return check_bundle(bundle)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnreachableStateWarning)  # a rule finds these
            machine = find_machine_class(name, folders)
    except MachineImportError as error:
        return [Finding(error.file, error.line, "error", error.problem)]
    return check_class(machine)


def _shown(file: str) -> str:
    """Shorten a path in the current folder; return another as it is."""
    path, here = Path(file), Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else file
