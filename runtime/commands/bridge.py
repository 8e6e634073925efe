"""``llfsm bridge``: whiteboards and other worlds."""

from __future__ import annotations

import click

from .lazy import LazyGroup

__all__ = ["bridge"]

# name: (where it is, what `llfsm bridge --help` says of it)
_COMMANDS = {
    "gusimplewhiteboard": (
        "llfsm.bridges.gusimplewhiteboard.command:gusimplewhiteboard",
        "Relay slots to and from a gusimplewhiteboard.",
    ),
}


@click.group(cls=LazyGroup, table=_COMMANDS)
def bridge() -> None:
    """Connect a whiteboard with another world."""
