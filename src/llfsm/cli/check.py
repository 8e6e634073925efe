"""``llfsm check``: all that is wrong with machines, as far as can be told without running them."""

from __future__ import annotations

import importlib
import traceback
import warnings
from pathlib import Path

import click

import llfsm.runtime
from llfsm.runtime.checking import Finding, check_bundle, check_class
from llfsm.runtime.engine.errors import UnreachableStateWarning

from .machine_names import find_bundle, find_machine

__all__ = ["check"]

_NOT_THEIRS = (
    str(Path(__file__).parent),
    str(Path(llfsm.runtime.__file__).parent),
    "<frozen ",
    importlib.__file__,
)


@click.command()
@click.argument("machines", nargs=-1, required=True, metavar="MACHINE...")
def check(machines: tuple[str, ...]) -> None:
    """Check each MACHINE: one that ships, package.module:Class, or a .machine bundle.

    Every finding is a line, FILE:LINE: error or warning: what is wrong. The exit status is 1 if
    there is an error. Sections and expressions are read, never run.

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
    bundle = find_bundle(name)
    if bundle is not None:
        return check_bundle(bundle)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnreachableStateWarning)  # there is a rule for it
            machine = find_machine(name)
    except click.ClickException:
        raise
    except Exception as error:  # of the imported module's own code, whatever it is
        where = _where(error)
        if where is None:
            raise
        text = error.msg if isinstance(error, SyntaxError) else str(error)
        return [Finding(*where, "error", f"{type(error).__name__}: {text}")]
    return check_class(machine)


def _where(error: Exception) -> tuple[str, int] | None:
    """Return the line of an imported module that an error comes from."""
    if isinstance(error, SyntaxError) and error.filename is not None:
        return error.filename, error.lineno or 1
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if frame.lineno and not frame.filename.startswith(_NOT_THEIRS):
            return frame.filename, frame.lineno
    return None


def _shown(file: str) -> str:
    """Return a path from the current folder, if it is in it."""
    path, here = Path(file), Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else file
