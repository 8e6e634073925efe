"""The command line's root: ``llfsm``, and ``clfsm`` as another name for ``llfsm run``.

Commands are imported when they are called; see :mod:`.lazy`. Every error of llfsm, and each of a
file that cannot be reached, is handled here: one line on standard error and exit status 1, or its
traceback with ``--debug``.
"""

from __future__ import annotations

import sys
from typing import Any

import click

from llfsm.errors import LlfsmError

from . import VERSION
from .lazy import LazyGroup

__all__ = ["clfsm", "main"]

_COMMANDS = {
    "new": ("llfsm.cli.new:new", "Make a machine to start from."),
    "run": ("llfsm.cli.run.command:run", "Run machines as one arrangement."),
    "ps": ("llfsm.cli.ps:ps", "List the running machines."),
    "suspend": ("llfsm.cli.requests:suspend", "Suspend a running machine."),
    "resume": ("llfsm.cli.requests:resume", "Resume a suspended machine."),
    "restart": ("llfsm.cli.requests:restart", "Restart a running machine."),
    "reload": (
        "llfsm.cli.requests:reload",
        "Restart a machine from the current version of its bundle.",
    ),
    "stop": ("llfsm.cli.requests:stop", "Stop a running machine."),
    "debug": ("llfsm.cli.debug.command:debug", "Run machines from a prompt, step by step."),
    "dap": ("llfsm.cli.dap.command:dap", "Let an editor debug machines."),
    "pause": ("llfsm.cli.pausing:pause", "Pause running machines between two turns."),
    "step": ("llfsm.cli.pausing:step", "Let paused machines go on for a turn, or further."),
    "continue": ("llfsm.cli.pausing:continue_", "Let paused machines go on."),
    "override": ("llfsm.cli.pausing:override", "Override a sensor of a running machine."),
    "why": ("llfsm.cli.why:why", "Show why a running machine is in its state."),
    "check": ("llfsm.cli.check:check", "Check machines without running them."),
    "verify": (
        "llfsm.cli.verify.command:verify",
        "Explore everything machines can do; decide properties.",
    ),
    "draw": ("llfsm.cli.draw:draw", "Draw a machine."),
    "show": ("llfsm.cli.show:show", "Show the states and transitions of a machine."),
    "import": (
        "llfsm.cli.import_bundle:import_",
        "Translate a bundle of C++ to Python.",
    ),
    "convert": (
        "llfsm.cli.convert:convert",
        "Make a bundle from a class, or a class from a bundle.",
    ),
    "package": (
        "llfsm.cli.package:package",
        "Write the ROS 2 package that starts a machine.",
    ),
    "turtlesim": (
        "llfsm.cli.turtlesim:turtlesim",
        "Simulate turtles, on a whiteboard or as a ROS 2 node.",
    ),
    "router": ("llfsm.cli.router:router", "Run a Zenoh router for ROS 2 nodes."),
    "edit": ("llfsm.cli.edit:edit", "Draw and write a machine in the browser."),
    "view": ("llfsm.cli.view:view", "Show a whiteboard and its machines in the browser."),
    "record": ("llfsm.cli.record:record", "Record a whiteboard to a file."),
    "replay": ("llfsm.cli.replay:replay", "Replay a recording to a whiteboard."),
    "rerun": ("llfsm.cli.rerun:rerun", "Run machines again on the inputs of a recording."),
    "guard": (
        "llfsm.cli.guard:guard",
        "Post the safe values of machines whose processes die.",
    ),
    "top": ("llfsm.cli.top:top", "Show a whiteboard and its machines in the terminal."),
    "whiteboard": (
        "llfsm.cli.whiteboard.group:whiteboard",
        "List, read, write and mirror whiteboards.",
    ),
    "bridge": ("llfsm.cli.bridge.group:bridge", "Connect a whiteboard with another world."),
    "demo": ("llfsm.cli.demo.command:demo", "Watch machines and turtles work together."),
}


class _Root(LazyGroup):
    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except Exception as error:
            if ctx.params["debug"]:
                raise
            if isinstance(error, LlfsmError):
                raise click.ClickException(str(error)) from error
            if isinstance(error, OSError) and error.filename is not None:
                raise click.ClickException(f"{error.filename}: {error.strerror}") from error
            raise


@click.group(cls=_Root, table=_COMMANDS, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
@click.version_option(VERSION)
def main(debug: bool) -> None:
    """Deterministic robot behaviours: state machines that pull from a typed whiteboard.

    Try `llfsm demo wall`, or `llfsm COMMAND --help`.
    """


def clfsm() -> None:
    """Run ``llfsm run``, under the name of its ancestor."""
    main.main(["run", *sys.argv[1:]], prog_name="clfsm")
