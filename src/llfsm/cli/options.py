"""The options and arguments that several commands share, and what ``--until-eof`` does."""

from __future__ import annotations

import functools
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import click

from llfsm.whiteboard import BoardNotFoundError, Whiteboard
from llfsm.whiteboard.board_files import DIRECTORY, board_path, default_name, group_id
from llfsm.whiteboard.mirror.naming import require_host_name

Command: TypeAlias = Callable[..., Any]


def collected(
    command: Command, name: str, make: Callable[..., Any], options: Iterable[str]
) -> Command:
    """Give a command one argument, which `make` makes of those options, in their place."""

    @functools.wraps(command)
    def with_one(**arguments: Any) -> Any:
        one = make(*map(arguments.pop, options))
        return command(**arguments, **{name: one})

    return with_one


class Integer(click.IntRange):
    """A whole number, maybe within a range; click would call it an "integer range" in any case."""

    name = "integer"


class Number(click.FloatRange):
    """A number, within a range if one is given."""

    name = "number"


def file_option(*names: str, **settings: Any) -> Callable[[Command], Command]:
    """Make an option that takes the path of a file."""
    return click.option(*names, metavar="FILE", type=click.Path(path_type=Path), **settings)


def directory_option(command: Command) -> Command:
    """Add the options of where whiteboards are; the command gets their folder as `directory`."""
    directory = click.option(
        "--directory",
        metavar="DIR",
        type=click.Path(file_okay=False),
        default=str(DIRECTORY),
        help="The folder of the whiteboards' files; by default /dev/shm.",
    )
    group = click.option(
        "--group",
        metavar="GROUP",
        callback=_set_group,
        expose_value=False,
        help="A group of users, to whom it belongs; by default $WHITEBOARD_GROUP, else to you.",
    )
    return directory(group(command))


def _set_group(_: click.Context, __: click.Parameter, group: str | None) -> None:
    """Let all that this process and those that it starts open be of a group."""
    if group is not None:
        os.environ["WHITEBOARD_GROUP"] = group
        group_id()


class BoardPlace(NamedTuple):
    """The name and the folder of a whiteboard, which may not exist."""

    name: str
    directory: str

    def open(self, *, create: bool = True) -> Whiteboard:
        """Open the whiteboard, or make it; without `create`, raise :class:`.BoardNotFoundError`."""
        return Whiteboard(self.name, directory=self.directory, create=create)

    @contextmanager
    def opened(self) -> Iterator[Whiteboard]:
        """Open the whiteboard, or make it; after an error, remove a new one that was not used."""
        try:
            wb, made = self.open(create=False), False
        except BoardNotFoundError:
            wb, made = self.open(), True
        with wb:
            try:
                yield wb
            except Exception:
                if made and not wb.slots():
                    wb.remove()
                raise

    @property
    def arguments(self) -> tuple[str, ...]:
        """The arguments by which another command gets the same whiteboard."""
        return "--board", self.name, "--directory", self.directory


def board_option(command: Command | None = None, *, default: str | None = None) -> Command:
    """Add the options that name a whiteboard; the command gets them as `board`, a `BoardPlace`."""
    if command is None:
        return functools.partial(board_option, default=default)

    def place(board: str, directory: str) -> BoardPlace:
        board_path(board, directory)  # raises an error for a name that no board can have
        return BoardPlace(board, directory)

    what = f"{default}" if default else "$WHITEBOARD_NAME, else `whiteboard`"
    option = click.option(
        "-b",
        "--board",
        metavar="NAME",
        default=default or default_name,
        help=f"The whiteboard; by default {what}.",
    )
    return option(directory_option(collected(command, "board", place, ("board", "directory"))))


break_option = click.option(
    "--break",
    "breakpoints",
    metavar="BREAKPOINT",
    multiple=True,
    help="Pause at Machine:STATE, Machine:STATE->TARGET, Machine! or @slot; ` if CONDITION` may "
    "follow.",
)

local_option = click.option(
    "--local",
    is_flag=True,
    help="Use a whiteboard private to this process, which needs no shared memory.",
)

record_option = file_option(
    "--record",
    "recording",
    help="Record the whiteboard and everything that the machines do, for llfsm rerun.",
)

recording_argument = click.argument("file", type=click.Path(path_type=Path))

host_option = click.option(
    "--host",
    metavar="NAME",
    default="",
    callback=lambda _, __, value: checked_host(value),
    help="Only this host of the fleet.",
)

fleet_option = click.option("--fleet", is_flag=True, help="All hosts of the fleet.")


def checked_host(value: str) -> str:
    """Return the name of a host; raise ``click.BadParameter`` for a text that cannot be one."""
    try:
        if value:
            require_host_name(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from error
    return value


topics_option = file_option(
    "--config",
    help="A bridge's configuration, which maps a bag's topics to slots; by default, by name.",
)

slots_option = click.option(
    "--slots",
    metavar="GLOB",
    multiple=True,
    help="Only slots whose names match, such as 'turtle1/*'. May be repeated.",
)

trust_option = click.option(
    "--trust",
    is_flag=True,
    help="Run the machines that the file names, from the folder that it names.",
)

_UNTIL_EOF = "llfsm.until_eof"

until_eof_option = click.option(
    "--until-eof",
    is_flag=True,
    expose_value=False,
    callback=lambda context, _, given: context.meta.update({_UNTIL_EOF: given}),
    help="End when standard input closes, as under a supervisor.",
)
"""A command that has it calls :func:`end_with_input` once it can end well."""


def supervised_options(command: Command) -> Command:
    """Add the options of a command that uses a whiteboard and may run under a supervisor."""
    return click.option(
        "--remove-board", is_flag=True, help="Remove the whiteboard at the end, on errors too."
    )(until_eof_option(command))


def output_option(what: str) -> Callable[[Command], Command]:
    """Return the option ``--output``: the folder in which to make `what`, named in its help."""
    return click.option(
        "-o",
        "--output",
        metavar="DIR",
        type=click.Path(file_okay=False, path_type=Path),
        default=".",
        help=f"Make {what} in this folder; by default the current one.",
    )


def given_option(*names: str) -> str | None:
    """Find the first of these parameters that the command line gives, as written there."""
    context = click.get_current_context()
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if parameter.name in names and source is click.core.ParameterSource.COMMANDLINE:
            return parameter.opts[-1]
    return None


class BoardRemovedError(click.ClickException):
    """The whiteboard of a command has been removed while it ran: another run may find a new one."""

    exit_code = 75  # EX_TEMPFAIL of <sysexits.h>

    def __init__(self, name: str):
        super().__init__(
            f"the whiteboard {name!r} was removed. If nobody did, a login session has ended: "
            f"RemoveIPC=no in /etc/systemd/logind.conf keeps boards"
        )


def end_with_input() -> None:
    """With ``--until-eof``, send this process SIGTERM when its standard input is closed.

    A supervisor that holds the other end of the pipe thus ends its processes even if it is killed.
    """
    if not click.get_current_context().meta.get(_UNTIL_EOF):
        return

    def wait() -> None:
        while os.read(0, 4096):
            pass
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, name="until-eof", daemon=True).start()
