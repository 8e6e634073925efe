"""The counts of a bridge's links, on the terminal."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import click

from llfsm.bridges.ros2.bridging.link import BridgeLink

if TYPE_CHECKING:
    from rich.table import Table

__all__ = ["Count", "Counts", "show_until"]

_FRAME_S = 0.25
_LINES_S = 10.0
_RATE_S = 1.0  # the shortest time over which a rate is measured


class Count(NamedTuple):
    """A link and its rate."""

    link: BridgeLink
    rate: float
    """Messages a second, lately."""

    def __str__(self) -> str:
        link, age = self.link, self.link.age
        ago = "" if age is None else f", the last {age:.1f} s ago"
        failed = f", {link.failed} failed" if link.failed else ""
        return f"{link}: {link.passed}, {self.rate:.1f}/s{ago}{failed}"


class Counts:
    """Count what links pass on; rates are those since the last `read` a second or more ago."""

    def __init__(
        self, links: Sequence[BridgeLink], now: Callable[[], float] = time.monotonic
    ) -> None:
        self._links = links
        self._now = now
        self._then = now()
        self._passed = [0] * len(links)
        self._rates = [0.0] * len(links)

    def read(self) -> list[Count]:
        """Return the current count of each link."""
        now = self._now()
        seconds = now - self._then
        if seconds >= _RATE_S:
            passed = [link.passed for link in self._links]
            self._rates = [
                (new - old) / seconds for new, old in zip(passed, self._passed, strict=True)
            ]
            self._then, self._passed = now, passed
        return [Count(*pair) for pair in zip(self._links, self._rates, strict=True)]


def show_until(over: Callable[[float], bool], links: Sequence[BridgeLink]) -> None:
    """Show counts on standard output until ``over(seconds)``, which waits that long, is true.

    On a terminal they are a table that is refreshed, else lines every 10 s and at the end.
    """
    counts = Counts(links)
    if not sys.stdout.isatty():
        while not over(_LINES_S):
            _print(counts)
        _print(counts)
        return
    from rich.live import Live

    with Live(_table(counts), auto_refresh=False) as live:
        for handler in logging.getLogger().handlers:
            if isinstance(handler, logging.StreamHandler):
                handler.setStream(sys.stderr)  # which Live has redirected above the table
        while not over(_FRAME_S):
            live.update(_table(counts), refresh=True)


def _print(counts: Counts) -> None:
    for count in counts.read():
        click.echo(str(count))


def _table(counts: Counts) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("slot", "", "ROS", "type"):
        table.add_column(title, overflow="fold")
    for title in ("passed", "per s", "age", "failed"):
        table.add_column(title, justify="right", no_wrap=True)
    for link, rate in counts.read():
        age = "" if link.age is None else f"{link.age:.1f} s"
        failed = str(link.failed) if link.failed else ""
        numbers = (str(link.passed), f"{rate:.1f}", age, failed)
        table.add_row(link.slot, link.arrow, link.name, link.type_name, *numbers)
    return table
