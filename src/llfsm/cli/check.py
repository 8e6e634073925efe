"""``llfsm check``: what is wrong with machines, as far as their text shows it."""

from __future__ import annotations

import warnings
from pathlib import Path

import click

from llfsm.runtime.checking import Finding, check_bundle, check_class
from llfsm.runtime.engine.errors import UnreachableStateWarning

from .machine_names import MachineImportError, find_bundle, find_machine, search_modules_in

__all__ = ["check"]


@click.command()
@click.argument("machines", nargs=-1, required=True, metavar="MACHINE...")
def check(machines: tuple[str, ...]) -> None:
    """Check each MACHINE: one that ships, patrol.py:Patrol, or a .machine bundle.

    Print a line for each finding: FILE:LINE: error or warning: what is wrong. The exit status is 1
    if there is an error. Sections and expressions are read, never run.

    \b
    llfsm check RosWallTurttleBot
    llfsm check patrol:Patrol Lamp.machine
    """
    findings = sorted({finding for machine in machines for finding in _check(machine)})
    for file, line, severity, text in findings:
        click.echo(f"{_shown(file)}:{line}: {severity}: {text}")
    if not findings:
        click.echo("no findings")
    if any(finding.severity == "error" for finding in findings):
        raise click.exceptions.Exit(1)


def _check(name: str) -> list[Finding]:
    search_modules_in()
    bundle = find_bundle(name)
    if bundle is not None:
        return check_bundle(bundle)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnreachableStateWarning)  # a rule finds these
            machine = find_machine(name)
    except MachineImportError as error:
        return [Finding(error.file, error.line, "error", error.problem)]
    return check_class(machine)


def _shown(file: str) -> str:
    """Return a path in the current folder relative to it, another as it is."""
    path, here = Path(file), Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else file
