"""``llfsm convert``, a class to a bundle or back, and ``llfsm import``, from C++ to Python."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click

from llfsm.cli.echo import echo
from llfsm.cli.machines import find_bundle, find_machine_class
from llfsm.cli.options import output_option
from llfsm.runtime.bundles import (
    SUFFIX,
    UNTRANSLATED,
    Fragment,
    import_bundle,
    read_bundle,
    write_bundle,
)
from llfsm.runtime.converting import write_converted


@click.command("import")
@click.argument("bundle", type=click.Path(exists=True, file_okay=False, path_type=Path))
@output_option("the new bundle")
@click.option("-f", "--force", is_flag=True, help="Replace an existing bundle.")
def import_(bundle: Path, output: Path, force: bool) -> None:
    """Translate BUNDLE, a bundle of C++, to a bundle of Python.

    Structure, layout, simple variables and simple expressions are translated. Other C++ becomes
    comments, with marks that prevent the bundle from running until they are replaced by hand.

    \b
    llfsm import clfsm/Patrol.machine -o machines
    """
    source = read_bundle(bundle)
    folder = output / f"{source.name}{SUFFIX}"
    write_bundle(import_bundle(source), folder, replace=force)
    echo(f"wrote {folder}")
    marks = [mark for _, _, text in read_bundle(folder).texts() for mark in _marks(text)]
    if marks:
        echo(f"{len(marks)} to translate by hand before it runs:")
    for mark in marks:
        echo(f"  {mark}")


def _marks(fragment: Fragment) -> Iterator[str]:
    for number, line in enumerate(fragment.text.splitlines(), 1):
        if line.startswith(UNTRANSLATED):
            yield f"{fragment.file}:{number}"


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
    echo(f"wrote {wrote}")
