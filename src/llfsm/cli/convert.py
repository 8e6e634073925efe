"""``llfsm convert``: a machine class as a bundle, or a bundle as a class."""

from __future__ import annotations

from pathlib import Path

import click

from llfsm.runtime.converting import write_converted

from .machine_names import find_bundle, find_machine_class
from .options import output_option

__all__ = ["convert"]


@click.command()
@click.argument("machine")
@output_option("it")
def convert(machine: str, output: Path) -> None:
    """Make a bundle from a class, or a class from a bundle, which does the same.

    MACHINE is patrol.py:Patrol, module:Class or a .machine bundle of Python. Its layout comes with
    it: that of a class is in a file beside it, Patrol.layout. Existing files are never replaced.

    \b
    llfsm convert patrol.py:Patrol
    llfsm convert Patrol.machine -o classes
    """
    folder = find_bundle(machine)
    wrote = write_converted(find_machine_class(machine) if folder is None else folder, output)
    click.echo(f"wrote {wrote}")
