"""The command line's root: ``llfsm``, and ``clfsm`` as another name for ``llfsm run``.

Commands are imported when they are called; see :mod:`.lazy`. Every error of llfsm is handled here:
one line on standard error and exit status 1, or its traceback with ``--debug``.
"""

from __future__ import annotations

import sys
from typing import Any

import click

from llfsm.errors import LlfsmError

from .lazy import LazyGroup

__all__ = ["clfsm", "main"]

_COMMANDS = {
    "new": ("llfsm.cli.new:new", "Make a machine to start from."),
    "run": ("llfsm.cli.run.command:run", "Run machines as one arrangement."),
    "ps": ("llfsm.cli.ps:ps", "List the running machines."),
    "suspend": ("llfsm.cli.requests:suspend", "Suspend a running machine."),
    "resume": ("llfsm.cli.requests:resume", "Resume a suspended machine."),
    "restart": ("llfsm.cli.requests:restart", "Restart a running machine."),
    "stop": ("llfsm.cli.requests:stop", "Ask a machine to end."),
    "check": ("llfsm.cli.check:check", "Check machines without running them."),
    "draw": ("llfsm.cli.draw:draw", "Draw a machine."),
    "show": ("llfsm.cli.show:show", "Show the states and transitions of a machine."),
    "import": (
        "llfsm.cli.import_bundle:import_",
        "Translate a bundle of C++ to Python.",
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
            if ctx.params["debug"] or not isinstance(error, LlfsmError):
                raise
            raise click.ClickException(str(error)) from error


@click.group(cls=_Root, table=_COMMANDS, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
@click.version_option(package_name="llfsm")
def main(debug: bool) -> None:
    """Deterministic robot behaviours: state machines that pull from a typed whiteboard.

    Try `llfsm demo wall`, or `llfsm COMMAND --help`.
    """


def clfsm() -> None:
    """Run ``llfsm run``, under the name of its ancestor."""
    main.main(["run", *sys.argv[1:]], prog_name="clfsm")
