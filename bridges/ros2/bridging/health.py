"""The health of a bridge's links, and of the machines on its whiteboard."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from itertools import chain

from llfsm.runtime.presence.remote import Directory, RemoteMachine
from llfsm.whiteboard import Board, WhiteboardError

from ..diagnostics import Health, HealthLevel
from .link import BridgeLink

__all__ = ["BridgeHealth"]

_OF_CONDITION = {
    "running": HealthLevel.OK,
    "suspended": HealthLevel.OK,
    "paused": HealthLevel.WARN,
    "failed": HealthLevel.ERROR,
    "hung": HealthLevel.ERROR,
    "silent": HealthLevel.STALE,
}


class BridgeHealth:
    """Reports rates and losses since the report before; call it on one thread."""

    def __init__(
        self, links: Sequence[BridgeLink], board: Board, now: Callable[[], float] = time.monotonic
    ) -> None:
        self._links = links
        self._machines = Directory(board)
        self._now = now
        self._then = now()
        self._before: dict[BridgeLink, tuple[int, int, int]] = {}
        self._ringlets: dict[str, int] = {}

    def report(self) -> list[Health]:
        """Return the health of each link and of each machine."""
        now = self._now()
        seconds, self._then = max(now - self._then, 1e-9), now
        links = (self._of_link(link, seconds) for link in self._links)
        return list(chain(links, self._of_machines(seconds)))

    def _of_link(self, link: BridgeLink, seconds: float) -> Health:
        passed, failed, broken, age = link.passed, link.failed, link.broken, link.age
        then_passed, then_failed, then_broken = self._before.get(link, (0, 0, 0))
        self._before[link] = passed, failed, broken
        lost, late = failed - then_failed, broken - then_broken
        wrong = [f"{lost} lost"] * (lost > 0) + [f"{late} too late"] * (late > 0)
        return Health(
            str(link),
            HealthLevel.WARN if wrong else HealthLevel.OK,
            f"{', '.join(wrong)} since the last report" if wrong else "nothing lost",
            {
                "type": link.type_name,
                "rate (Hz)": f"{(passed - then_passed) / seconds:.1f}",
                "age (s)": "" if age is None else f"{age:.3f}",
                "passed": str(passed),
                "lost": str(failed),
                "too late": str(broken),
            },
        )

    def _of_machines(self, seconds: float) -> Iterator[Health]:
        try:
            machines = self._machines.machines()
        except WhiteboardError:  # the board has gone: so have its machines
            return
        then, self._ringlets = self._ringlets, {m.name: m.status.ringlets for m in machines}
        for machine in machines:
            turns = machine.status.ringlets - then.get(machine.name, machine.status.ringlets)
            yield _of_machine(machine, max(turns, 0) / seconds)


def _of_machine(machine: RemoteMachine, rate: float) -> Health:
    status, condition = machine.status, machine.condition
    return Health(
        f"machine {machine.name}",
        _OF_CONDITION[condition],
        f"{condition}: {status.error}" if status.error else condition,
        {
            "state": status.state,
            "rate (Hz)": f"{rate:.1f}",
            "age (s)": f"{machine.silent_s:.3f}",
            "overruns": str(status.overruns),
            "failed": str(status.failed),
        },
    )
