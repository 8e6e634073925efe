"""``llfsm edit``: a machine drawn, written, checked and simulated on a page in the browser."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from llfsm.cli.echo import echo
from llfsm.cli.machines import find_bundle, find_machine_class
from llfsm.cli.options import directory_option, end_with_input, until_eof_option
from llfsm.cli.view import page_options, serve
from llfsm.errors import LlfsmError
from llfsm.runtime.converting.class_files import class_file
from llfsm.runtime.converting.class_process import ClassName
from llfsm.runtime.editing import Document
from llfsm.runtime.editing.class_document import ClassDocument
from llfsm.runtime.plans import names_of, read_plan

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from llfsm.bridges.edit.edit_app import OpenedPlan


_HERE: Final = (Path(),)


class _Edit(click.Command):
    """Suggest --address for --host, as many servers call it.

    In `llfsm view --host robot7` it is a host of the fleet.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            if error.option_name != "--host":
                raise
            what = "No such option '--host'. Did you mean '--address'?"
            raise click.NoSuchOption("--host", what, ctx=ctx) from error


@click.command(cls=_Edit)
@click.argument("machine")
@click.option("-b", "--board", metavar="NAME", help="Show where the machine stands on a board.")
@directory_option
@page_options
@click.option("--control", is_flag=True, help="With --board: let the page reload the live machine.")
@until_eof_option
def edit(
    machine: str,
    board: str | None,
    directory: str,
    address: str,
    port: int,
    no_open: bool,
    control: bool,
) -> None:
    """Draw, write, check and simulate MACHINE, a .machine bundle, on a page, until Ctrl-C.

    For an arrangement file, each machine has a tab, beside an overview of what they read, post and
    request of each other.

    Each edit is written at once, and nothing else in the bundle changes. `llfsm new --bundle` makes
    one to start from. Its code is run only by the page's button Simulate. For a C++ bundle or a
    class, patrol.py:Patrol, only the layout is edited. A class's module is imported whenever it
    changes, and its layout is kept beside it, in Patrol.layout. The page needs the token in the
    printed address: $LLFSM_VIEW_TOKEN, or else a new one.

    \b
    llfsm edit Patrol
    llfsm edit machines/Patrol.machine --no-open
    llfsm edit patrol.py:Patrol
    llfsm edit Patrol -b robot --control
    llfsm edit robot.toml
    """
    end_with_input()
    if control and board is None:
        raise click.UsageError("--control is for a live machine: add --board")
    opened = _opened_plan(Path(machine)) if machine.endswith(".toml") else _opened(machine)

    def make_app(token: str) -> ASGIApp:
        from llfsm.bridges.edit.edit_app import make_edit_app
        from llfsm.bridges.view.live_source import LiveSource

        source = None if board is None else LiveSource(board, directory)
        return make_edit_app(opened, host=address, token=token, source=source, control=control)

    what = f"llfsm edit: {opened.path}"
    serve(make_app, what, host=address, port=port, open_page=not no_open)


def _opened(machine: str) -> Document:
    is_class = ":" in machine or machine.endswith(".py")
    if not is_class and find_bundle(machine, _HERE) is None:
        raise click.UsageError(
            f"no bundle {machine!r}; make one with: llfsm new {machine} --bundle"
        )
    return _document(machine, _HERE)


def _document(machine: str, folders: Sequence[Path]) -> Document:
    folder = find_bundle(machine, folders)
    if folder is not None:
        document = Document(folder)
    else:
        cls = find_machine_class(machine, folders)
        document = ClassDocument(ClassName(class_file(cls), cls.__module__, cls.__qualname__))
    if document.recovered:
        echo(f"{document.path}: an interrupted edit has been taken back", err=True)
    return document


def _opened_plan(file: Path) -> OpenedPlan:
    """Open the machines of an arrangement file; what cannot be opened is shown in its place."""
    from llfsm.bridges.edit.edit_app import OpenedMachine, OpenedPlan

    plan = read_plan(file)
    folders = (file.absolute().parent, Path())
    machines, classes = [], []
    for planned in plan.machines:
        try:
            document = _document(planned.definition, folders)
        except (click.UsageError, LlfsmError) as error:
            machines.append(OpenedMachine(planned, None, str(error)))
            classes.append(Path(planned.definition.rpartition(":")[2]).stem)
        else:
            machines.append(OpenedMachine(planned, document))
            classes.append(document.folder.name)
    return OpenedPlan(file.absolute(), dict(zip(names_of(plan, classes), machines, strict=True)))
