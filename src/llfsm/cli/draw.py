"""``llfsm draw``: a machine as a picture, or as text that other tools draw."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from llfsm.cli.machines import find_bundle, find_machine_class, parse_arguments
from llfsm.runtime.bundles import outline, read_bundle
from llfsm.runtime.checking import requests_of
from llfsm.runtime.converting import class_layout
from llfsm.runtime.drawing import arrange, overview, to_dot, to_mermaid, to_png, to_svg
from llfsm.runtime.drawing.arrange import links_of
from llfsm.runtime.engine.table import Table

_SUFFIXES = {
    ".dot": "dot", ".gv": "dot", ".mmd": "mermaid", ".mermaid": "mermaid",
    ".svg": "svg", ".png": "png",
}  # fmt: skip


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
    type=click.Choice(["dot", "mermaid", "svg", "png"]),
    help="The format; by default that of FILE's suffix, and dot without a FILE.",
)
@click.option(
    "--sections/--fold",
    default=None,
    help="Show the states' code or only their names; by default as in the machine's layout.",
)
def draw(machine: str, output: Path | None, form: str | None, sections: bool | None) -> None:
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
    written = _overview(machine, form) if is_plan else _drawn(*_table(machine), form, sections)
    if output is None:
        if form == "png" and sys.stdout.isatty():
            raise click.UsageError("a PNG is not for a terminal: name a file with -o FILE")
        click.echo(written, nl=False)
        return
    try:
        output.write_bytes(written)
    except OSError as error:
        raise click.ClickException(f"cannot write {output}: {error.strerror}") from error


def _overview(file: str, form: str) -> bytes:
    """Return the overview of an arrangement file."""
    if form not in ("svg", "png"):
        raise click.UsageError(f"an arrangement is drawn as svg or png, not as {form}")
    resolved = parse_arguments([file], None, (), ())
    found = zip(resolved.classes.items(), resolved.plan.machines, strict=True)
    machines = {
        name: links_of(cls, planned.slots, requests_of(cls, planned.variables))
        for (name, cls), planned in found
    }
    diagram = overview(Path(file).name, machines)
    return to_png(diagram) if form == "png" else to_svg(diagram).encode()


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
    """Return the table and the name of a machine."""
    folder = find_bundle(machine)
    if folder is not None:
        bundle = read_bundle(folder)
        return outline(bundle), bundle.name
    found = find_machine_class(machine)
    found.table.layout = class_layout(found)
    return found.table, found.__name__


def _drawn(table: Table, title: str, form: str, sections: bool | None) -> bytes:
    if form == "dot":
        return to_dot(table, title=title, sections=bool(sections)).encode()
    if form == "mermaid":
        return to_mermaid(table, title=title, sections=bool(sections)).encode()
    diagram = arrange(table, title=title, sections=sections)
    return to_png(diagram) if form == "png" else to_svg(diagram).encode()
