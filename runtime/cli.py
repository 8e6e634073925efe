"""The command line's root: ``llfsm``, and ``clfsm`` as another name for ``llfsm run``.

Commands are imported when they are called, and found by name; see :mod:`.commands.lazy`.
"""

from __future__ import annotations

from typing import Any

import click

from .commands.lazy import LazyGroup

__all__ = ["clfsm", "main"]

# name: (where it is, what `llfsm --help` says of it)
_COMMANDS = {
    "new": ("llfsm.runtime.commands.new:new", "Make a machine to start from."),
    "run": ("llfsm.runtime.commands.run:run", "Run machines as one arrangement."),
    "ps": ("llfsm.runtime.commands.control:ps", "List the machines that run."),
    "suspend": ("llfsm.runtime.commands.control:suspend", "Suspend a machine that runs."),
    "resume": ("llfsm.runtime.commands.control:resume", "Resume a suspended machine."),
    "restart": ("llfsm.runtime.commands.control:restart", "Restart a machine that runs."),
    "stop": ("llfsm.runtime.commands.control:stop", "Ask a machine to end."),
    "check": ("llfsm.runtime.commands.check:check", "Check machines without running them."),
    "draw": ("llfsm.runtime.commands.draw:draw", "Draw a machine."),
    "show": ("llfsm.runtime.commands.show:show", "Show what a machine consists of."),
    "import": (
        "llfsm.runtime.commands.importing:import_",
        "Make a bundle of Python from one of C++.",
    ),
    "package": (
        "llfsm.runtime.commands.package:package",
        "Write the ROS 2 package that starts a machine.",
    ),
    "turtlesim": (
        "llfsm.bridges.turtlesim.command:turtlesim",
        "Simulate turtles, on a whiteboard or as a ROS 2 node.",
    ),
    "router": ("llfsm.bridges.ros2.router:router", "Let ROS 2 nodes over Zenoh find each other."),
    "view": ("llfsm.bridges.view.command:view", "Show a whiteboard and its machines on a page."),
    "record": ("llfsm.bridges.recording.command:record", "Record a whiteboard to a file."),
    "replay": ("llfsm.bridges.recording.command:replay", "Replay a recording to a whiteboard."),
    "rerun": ("llfsm.bridges.recording.command:rerun", "Run machines on what was recorded."),
    "top": ("llfsm.runtime.commands.top:top", "Show a whiteboard and its machines, live."),
    "whiteboard": ("llfsm.runtime.commands.board:whiteboard", "List, read and write whiteboards."),
    "bridge": ("llfsm.runtime.commands.bridge:bridge", "Connect a whiteboard with another world."),
    "demo": ("llfsm.runtime.commands.demo:demo", "Watch machines and turtles work together."),
}


class _Root(LazyGroup):
    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except Exception as error:
            if ctx.params["debug"] or not isinstance(error, _ours()):
                raise
            raise click.ClickException(str(error)) from error


def _ours() -> tuple[type[Exception], ...]:
    """Return the errors that tell a user what to do, and so need no traceback."""
    from llfsm.whiteboard.errors import WhiteboardError

    from .errors import FsmError

    return WhiteboardError, FsmError


@click.group(cls=_Root, table=_COMMANDS, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
@click.version_option(package_name="llfsm")
def main(debug: bool) -> None:
    """Deterministic robot behaviours: state machines that pull from a typed whiteboard.

    Try `llfsm demo wall`, or `llfsm COMMAND --help`.
    """


def clfsm() -> None:
    """Be ``llfsm run`` for those who type its ancestor's name."""
    import sys

    main.main(["run", *sys.argv[1:]], prog_name="clfsm")
