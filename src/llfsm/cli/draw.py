"""``llfsm draw``: a machine as a picture, or as text that other tools draw."""

from __future__ import annotations

import sys
from contextlib import suppress
from functools import partial
from pathlib import Path

import click

from llfsm.cli.machines import find_bundle, find_machine_class, parse_arguments
from llfsm.errors import printable
from llfsm.runtime.bundles import outline, read_bundle
from llfsm.runtime.bundles.compiling import outline_beside
from llfsm.runtime.checking import requests_of
from llfsm.runtime.converting import class_layout
from llfsm.runtime.drawing import overview
from llfsm.runtime.drawing.arrange import links_of
from llfsm.runtime.drawing.formats import FORMATS
from llfsm.runtime.engine.table import Table

_SUFFIXES = {suffix: name for name, form in FORMATS.items() for suffix in form.suffixes}
_PICTURES = [name for name, form in FORMATS.items() if form.write_diagram]


@click.command()
@click.argument("machine")
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write to FILE instead of standard output.",
)
@click.option(
    "--format",
    "form",
    type=click.Choice([*FORMATS]),
    help="The format; by default that of FILE's suffix, and dot without a FILE.",
)
@click.option(
    "--sections/--fold",
    default=None,
    help="Show the states' code or only their names; by default as in the machine's layout.",
)
@click.option(
    "--unfold", is_flag=True, help="Draw machines inside the states that run them; SVG and PNG."
)
def draw(
    machine: str, output: Path | None, form: str | None, sections: bool | None, unfold: bool
) -> None:
    """Draw MACHINE: one that ships, patrol.py:Patrol, or a .machine bundle.

    For an arrangement file, draw which slots each machine reads and posts, and which requests it
    sends to other machines.

    A bundle may be of Python or C++; its code is not run. The layout of a bundle, or of the file
    beside a class, is kept; without one, states are laid out from the initial state down.

    \b
    llfsm draw RosWallTurttleBot -o wall.svg
    llfsm draw RosPingPong -o pingpong.png --sections
    llfsm draw Lamp.machine --format mermaid
    llfsm draw robot.toml -o robot.svg
    """
    is_plan = machine.endswith(".toml")
    form = form or (_format_of(output) if output or not is_plan else "svg")
    if unfold and (is_plan or form not in _PICTURES):
        raise click.UsageError(f"--unfold is for a machine, drawn as {' or '.join(_PICTURES)}")
    if is_plan:
        written = _overview(machine, form)
    else:
        found = partial(_inner, machine) if unfold else None
        written = FORMATS[form].draw(*_table(machine), sections, found)
    if output is None:
        if isinstance(written, bytes) and sys.stdout.isatty():
            raise click.UsageError(
                f"a {form.upper()} is not for a terminal: name a file with -o FILE"
            )
        if isinstance(written, str) and sys.stdout.isatty():
            written = printable(written)
        click.echo(written, nl=False)
        return
    try:
        output.write_bytes(written if isinstance(written, bytes) else written.encode())
    except OSError as error:
        raise click.ClickException(f"cannot write {output}: {error.strerror}") from error


def _overview(file: str, form: str) -> str | bytes:
    """Draw the overview of an arrangement file."""
    write = FORMATS[form].write_diagram
    if write is None:
        raise click.UsageError(
            f"an arrangement is drawn as {' or '.join(_PICTURES)}, not as {form}"
        )
    resolved = parse_arguments([file])
    found = zip(resolved.classes.items(), resolved.plan.machines, strict=True)
    machines = {
        name: links_of(cls, planned.slots, requests_of(cls, planned.variables))
        for (name, cls), planned in found
    }
    return write(overview(Path(file).name, machines))


def _inner(machine: str, name: str) -> Table | None:
    """Find what a state runs by its name: a bundle beside the machine, or any other machine."""
    folder = find_bundle(machine)
    beside = None if folder is None else outline_beside(read_bundle(folder), name)
    if beside is not None:
        return beside
    with suppress(click.ClickException):
        return _table(name)[0]
    return None


def _format_of(output: Path | None) -> str:
    if output is None:
        return "dot"
    form = _SUFFIXES.get(output.suffix.lower())
    if form is None:
        raise click.UsageError(
            f"{output}: its suffix is not that of a format ({', '.join(_SUFFIXES)}); "
            f"rename it or give --format"
        )
    return form


def _table(machine: str) -> tuple[Table, str]:
    """Find a machine, and return its table, with its layout, and its name."""
    folder = find_bundle(machine)
    if folder is not None:
        bundle = read_bundle(folder)
        return outline(bundle), bundle.name
    found = find_machine_class(machine)
    found.table.layout = class_layout(found)
    return found.table, found.__name__
