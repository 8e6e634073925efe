"""The command line's root: ``llfsm``, its groups, and ``clfsm`` as another name for ``llfsm run``.

A group is a table of commands, which are imported when they are called, so that ``--help`` is fast.
The table names each command as ``module:function`` in llfsm.cli, which no type checker sees:
tests/cli/test_lazy.py resolves every row.

Every error of llfsm, and each of a file that cannot be reached, is handled here: one line on
standard error and exit status 1, or its traceback with ``--debug``. SIGTERM ends commands as
Ctrl-C does, so that no temporary file is left; commands that run until then handle it themselves.
"""

from __future__ import annotations

import importlib
import signal
import sys
import threading
from collections.abc import Mapping
from typing import Any, NoReturn, TypeAlias

import click

from llfsm.cli import VERSION
from llfsm.errors import LlfsmError, did_you_mean, printable

_Rows: TypeAlias = Mapping[str, tuple[str, str]]
"""Commands by name: ``module:function``, and the short help."""


class LazyGroup(click.Group):
    """A group made from a table, whose `sections` have titles in its help."""

    def __init__(self, *args: Any, sections: Mapping[str, _Rows], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.sections = sections
        self.table = {
            name: (f"llfsm.cli.{place}", text)
            for rows in sections.values()
            for name, (place, text) in rows.items()
        }

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names, in the table's order."""
        return list(self.table)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Import a command."""
        if name not in self.table:
            return None
        module, _, attribute = self.table[name][0].partition(":")
        command = getattr(importlib.import_module(module), attribute)
        assert isinstance(command, click.Command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command of the arguments; the error for an unknown one names similar ones."""
        name = args[0]
        if name in self.table or name.startswith("-") or ctx.resilient_parsing:
            return super().resolve_command(ctx, args)
        near = did_you_mean(name, self.table) or f"; see `{ctx.command_path} --help`"
        raise click.UsageError(f"no command {name!r}{near}", ctx)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the table's short help of each command, without importing it."""
        width = max(map(len, self.table))
        for title, rows in self.sections.items():
            with formatter.section(title):
                texts = [(name.ljust(width), text) for name, (_, text) in rows.items()]
                formatter.write_dl(texts)


_COMMANDS = {
    "Begin": {
        "demo": ("demo.command:demo", "Watch machines and turtles work together."),
        "new": ("new:new", "Make a machine to start from."),
        "run": ("run.command:run", "Run machines as one arrangement."),
        "ps": ("ps:ps", "List the running machines."),
        "view": ("view:view", "Show a whiteboard and its machines in the browser."),
        "check": ("check:check", "Check machines without running them."),
        "verify": ("verify:verify", "Explore everything machines can do; decide properties."),
        "edit": ("edit:edit", "Draw and write a machine in the browser."),
    },
    "Run": {
        "up": ("up.command:up", "Start several processes as one system."),
        "suspend": ("requests:suspend", "Suspend a running machine."),
        "resume": ("requests:resume", "Resume a suspended machine."),
        "restart": ("requests:restart", "Restart a running machine."),
        "stop": ("requests:stop", "Stop a running machine."),
        "reload": ("requests:reload", "Restart a machine from the current version of its bundle."),
        "guard": ("guard:guard", "Post the safe values of machines whose processes die."),
        "package": ("package:package", "Write the ROS 2 package that starts a machine."),
    },
    "Look": {
        "top": ("ps:top", "Show a whiteboard and its machines in the terminal."),
        "why": ("requests:why", "Show why a running machine is in its state."),
        "pause": ("requests:pause", "Pause running machines between two turns."),
        "step": ("requests:step", "Let paused machines go on for a turn, or further."),
        "continue": ("requests:continue_", "Let paused machines go on."),
        "override": ("requests:override", "Override a sensor of a running machine."),
        "debug": ("debug.command:debug", "Run machines from a prompt, step by step."),
        "dap": ("dap.adapter:dap", "Let an editor debug machines."),
        "show": ("show:show", "Show the states and transitions of a machine."),
        "draw": ("draw:draw", "Draw a machine."),
    },
    "Record": {
        "record": ("record:record", "Record a whiteboard to a file."),
        "replay": ("replay:replay", "Replay a recording to a whiteboard."),
        "rerun": ("rerun:rerun", "Run machines again on the inputs of a recording."),
    },
    "Connect": {
        "whiteboard": ("root:whiteboard", "List, read, write and mirror whiteboards."),
        "bridge": ("root:bridge", "Connect a whiteboard with another world."),
        "turtlesim": (
            "turtlesim:turtlesim",
            "Simulate turtles, also as a ROS 2 node.",
        ),
        "router": ("router:router", "Run a Zenoh router for ROS 2 nodes."),
    },
    "Write": {
        "import": ("convert:import_", "Translate a bundle of C++ to Python."),
        "convert": ("convert:convert", "Make a bundle from a class, or a class from a bundle."),
    },
}

_WHITEBOARD = {
    "list": ("whiteboard:list_", "List whiteboards, or the slots of one."),
    "get": ("whiteboard:get", "Print the latest message of a slot."),
    "add": ("whiteboard:add", "Add a message to a slot."),
    "watch": ("whiteboard:watch", "Print messages as they are added."),
    "rm": ("whiteboard:rm", "Remove whiteboards."),
    "daemon": ("whiteboard:daemon", "Mirror a whiteboard between hosts."),
    "status": ("whiteboard:status", "Print the status of the daemon."),
}

_BRIDGE = {
    "ros2": ("bridge.ros2:ros2", "Relay slots and topics, and serve services."),
    "check": ("bridge.ros2:check", "Check a configuration for `ros2`."),
    "turtlesim": ("bridge.ros2:turtlesim", "Connect machines with turtlesim."),
    "gusimplewhiteboard": (
        "bridge.gusimplewhiteboard:gusimplewhiteboard",
        "Relay slots to and from a gusimplewhiteboard.",
    ),
}


_NO_THREAD = "can't start new thread"  # as Python reports that there is no memory for one
_TERMINATED = 128 + signal.SIGTERM  # as shells report it


class _TerminatedError(KeyboardInterrupt):
    """SIGTERM has come. A `SystemExit` would be an error of the machine whose code runs."""


def _terminate(*_: object) -> NoReturn:
    raise _TerminatedError


class _Root(LazyGroup):
    def invoke(self, ctx: click.Context) -> Any:
        is_main = threading.current_thread() is threading.main_thread()
        if is_main and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, _terminate)
        try:
            return super().invoke(ctx)
        except _TerminatedError:
            raise SystemExit(_TERMINATED) from None
        except click.ClickException as error:
            error.message = printable(error.message)  # type: ignore[misc]  # it is final
            raise
        except Exception as error:
            if ctx.params["debug"]:
                raise
            if isinstance(error, LlfsmError):
                raise click.ClickException(printable(str(error))) from error
            if isinstance(error, MemoryError) or _NO_THREAD in str(error):
                text = "this process may not have the memory that it needs (ulimit -v, a container)"
                raise click.ClickException(text) from error
            if isinstance(error, OSError) and error.filename is not None:
                text = printable(f"{error.filename}: {error.strerror}")
                raise click.ClickException(text) from error
            raise
        except BaseException as error:
            if type(error).__name__ != "PanicException" or ctx.params["debug"]:  # of zenoh, in Rust
                raise
            raise click.ClickException(printable(f"zenoh has failed: {error}")) from error


@click.group(
    cls=_Root, sections=_COMMANDS, context_settings={"help_option_names": ["-h", "--help"]}
)
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
@click.version_option(VERSION)
def main(debug: bool) -> None:
    """Deterministic robot behaviours: state machines that pull from a typed whiteboard.

    Try `llfsm demo wall`, or `llfsm COMMAND --help`.
    """


@click.group(cls=LazyGroup, sections={"Commands": _WHITEBOARD})
def whiteboard() -> None:
    """List, read and write whiteboards, and mirror one between hosts.

    \b
    llfsm whiteboard list
    llfsm whiteboard get turtle1/pose -b demo
    llfsm whiteboard add turtle1/cmd_vel '{"linear": {"x": 1}}' -b demo
    """


@click.group(cls=LazyGroup, sections={"Commands": _BRIDGE})
def bridge() -> None:
    """Connect a whiteboard with ROS 2, with or without ROS installed, or with another world.

    \b
    llfsm bridge ros2 --config bridge.toml
    llfsm bridge ros2 --to-ros pinpong:std_msgs/msg/String
    llfsm bridge check bridge.toml
    llfsm bridge turtlesim
    """


def clfsm() -> None:
    """Run ``llfsm run``, under the name of its ancestor."""
    main.main(["run", *sys.argv[1:]], prog_name="clfsm")
