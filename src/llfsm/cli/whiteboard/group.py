"""The group ``llfsm whiteboard``."""

from __future__ import annotations

import click

from ..lazy import LazyGroup

__all__ = ["whiteboard"]

_COMMANDS = {
    "list": ("llfsm.cli.whiteboard.boards:list_", "List whiteboards, or the slots of one."),
    "get": ("llfsm.cli.whiteboard.boards:get", "Print the latest message of a slot."),
    "add": ("llfsm.cli.whiteboard.boards:add", "Add a message to a slot."),
    "watch": ("llfsm.cli.whiteboard.boards:watch", "Print messages as they are added."),
    "rm": ("llfsm.cli.whiteboard.boards:rm", "Remove whiteboards."),
    "daemon": ("llfsm.cli.whiteboard.daemon:daemon", "Mirror a whiteboard between hosts."),
    "status": ("llfsm.cli.whiteboard.daemon:status", "Print the status of the daemon."),
}


@click.group(cls=LazyGroup, table=_COMMANDS)
def whiteboard() -> None:
    """List, read and write whiteboards, and mirror one between hosts.

    \b
    llfsm whiteboard list
    llfsm whiteboard get turtle1/pose -b demo
    llfsm whiteboard add turtle1/cmd_vel '{"linear": {"x": 1}}' -b demo
    """
