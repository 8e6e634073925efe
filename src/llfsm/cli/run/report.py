"""What ``llfsm run -v`` and ``-s`` tell, in clfsm's format, on standard error."""

from __future__ import annotations

import click

from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.events import Event, Request, Turn

__all__ = ["StateReport", "SuspensionReport"]


class StateReport:
    """Tell of each machine that begins a turn in another state: ``m  0 s  1 - Machine - STATE``."""

    def __init__(self, arrangement: Arrangement, *, with_path: bool) -> None:
        self._arrangement = arrangement
        self._with_path = with_path

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, Turn) and event.previous != event.state:
            table = type(self._arrangement.machine(event.machine)).table
            names = [state.name for state in table.states]
            # A suspend state that the machine does not declare comes after those it does.
            number = names.index(event.state) if event.state in names else len(names)
            path = f"{table.path:<30.30} / " if self._with_path else ""
            click.echo(
                f"m{event.index:3d} s{number:3d} - {path}{event.machine:<20.20} - {event.state}",
                err=True,
            )


class SuspensionReport:
    """Tell of each suspend, resume and restart as it takes effect."""

    def __init__(self, arrangement: Arrangement) -> None:
        self._arrangement = arrangement
        self._due: Turn | None = None

    def __call__(self, event: Event) -> None:
        """Take an event: what follows a turn with a request shows what came of it."""
        due, self._due = self._due, None
        if due is not None:  # the request has been applied, and no transition has fired since
            state = self._arrangement.state_name_of(due.machine)
            if state != due.state or due.request == Request.RESTART:
                request = str(due.request).title()
                click.echo(f"{request} {due.index}: {due.state} -> {state}", err=True)
        if isinstance(event, Turn) and event.request is not None:
            self._due = event
