"""What ``llfsm run`` prints: with ``-v`` and ``-s`` in clfsm's format, with ``-t``, and logs."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable

import click

from llfsm.cli.console import log_to_console
from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.events import Event, Request, Turn
from llfsm.runtime.engine.statistics import MachineStatistics, Spread

_HEADS = ("machine", "ringlets", "fired", "cost us", "jitter us", "late us", "overruns", "worst us")


class StateReport:
    """Print each change of state: ``m  0 s  1 - Machine - STATE``.

    With times, a line begins with the seconds since the first one.
    """

    def __init__(self, arrangement: Arrangement, *, with_path: bool, with_times: bool) -> None:
        self._arrangement = arrangement
        self._with_path = with_path
        self._with_times = with_times
        self._begin_ns: int | None = None

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, Turn) and event.previous != event.state:
            table = type(self._arrangement.machine(event.machine)).table
            names = [state.name for state in table.states]
            # A suspend state that the machine does not declare comes after those it does.
            number = names.index(event.state) if event.state in names else len(names)
            path = f"{table.path:<30.30} / " if self._with_path else ""
            if self._begin_ns is None:
                self._begin_ns = event.time_ns
            seconds = (event.time_ns - self._begin_ns) / 1e9
            time = f"{seconds:10.6f} " if self._with_times else ""
            change = f"m{event.index:3d} s{number:3d} - {path}{event.machine:<20.20}"
            click.echo(f"{time}{change} - {event.state}", err=True)


class SuspensionReport:
    """Print each suspend, resume and restart when it takes effect."""

    def __init__(self, arrangement: Arrangement) -> None:
        self._arrangement = arrangement
        self._due: Turn | None = None

    def __call__(self, event: Event) -> None:
        """Take an event: the one after a turn with a request shows the effect of the request."""
        due, self._due = self._due, None
        if due is not None:  # the request has been applied, and no transition has fired since
            state = self._arrangement.state_name_of(due.machine)
            if state != due.state or due.request == Request.RESTART:
                request = str(due.request).title()
                click.echo(f"{request} {due.index}: {due.state} -> {state}", err=True)
        if isinstance(event, Turn) and event.request is not None:
            self._due = event


def timing_table(machines: Iterable[MachineStatistics]) -> str:
    """Return a table of the machines' statistics: spreads as p50 / p99 / max, states below."""
    rows = [_HEADS]
    notes: list[list[str]] = [[]]
    for machine in machines:
        planned = machine.jitter_us is not None
        rows.append(
            (
                machine.machine,
                str(machine.ringlets),
                str(machine.fired),
                _spread(machine.cost_us),
                _spread(machine.jitter_us),
                _spread(machine.late_us),
                str(machine.overruns) if planned else "-",
                f"{machine.worst_overrun_us:.0f}" if planned else "-",
            )
        )
        total = sum(machine.state_s.values()) or 1.0
        width = max((len(state) for state in machine.state_s), default=0)
        notes.append(
            [
                f"    {state.ljust(width)} {seconds:10.3f} s {seconds / total:6.1%}"
                for state, seconds in machine.state_s.items()
            ]
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row, states in zip(rows, notes, strict=True):
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines += ["  ".join(cells), *states]
    return "\n".join(lines)


def conditions(machines: Iterable[MachineStatistics]) -> str:
    """Return in which real time turns were given, if in any: all machines have the same."""
    for machine in machines:
        if machine.realtime is not None:
            core = "" if machine.cpu is None else f" on core {machine.cpu}"
            return f"in real time: FIFO {machine.realtime}{core}, memory locked"
    return ""


def latency_drawing(machines: Iterable[MachineStatistics]) -> str:
    """Return a drawing of how late turns began: a bar for each doubling of microseconds."""
    by_counts: dict[tuple[int, ...], list[str]] = {}
    for machine in machines:
        if machine.late_counts:
            by_counts.setdefault(machine.late_counts, []).append(machine.machine)
    lines: list[str] = []
    for counts, names in by_counts.items():  # with a period, the turns of all begin with one
        lines.append(f"turns of {', '.join(names)} that began late")
        first = next(place for place, count in enumerate(counts) if count)
        for place, count in enumerate(counts[first:], first):
            bar = "#" * -(-count * 40 // max(counts))
            lines.append(f"{'<':>5} {2**place:>8} us {count:>9}  {bar}".rstrip())
    return "\n".join(lines)


def _spread(spread: Spread | None) -> str:
    return "-" if spread is None else f"{spread.p50:.1f} / {spread.p99:.1f} / {spread.max:.1f}"


def log_machines(*, is_on: bool) -> None:
    """Log messages of machines to standard output, warnings and errors to standard error."""
    messages, problems = logging.StreamHandler(sys.stdout), logging.StreamHandler(sys.stderr)
    messages.addFilter(lambda record: record.levelno < logging.WARNING)
    problems.setLevel(logging.WARNING)
    log_to_console(logging.INFO, messages, problems, is_on=is_on)
