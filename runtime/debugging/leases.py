"""Overrides of sensors that end when nobody renews them."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from llfsm.runtime.engine.failure import logger

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement

__all__ = ["OverrideLeases"]


class OverrideLeases:
    """When the overrides of an arrangement's sensors end; those without a lease do not."""

    def __init__(self, arrangement: Arrangement):
        self._arrangement = arrangement
        self._ends_s: dict[tuple[str, str], float] = {}  # by machine and slot

    def begin(self, machine: str, slot: str, lease_s: float) -> None:
        """Let an override last so long from now on."""
        self._ends_s[machine, slot] = time.monotonic() + lease_s

    def end(self, machine: str, slot: str) -> None:
        """Let an override last until it is released."""
        self._ends_s.pop((machine, slot), None)

    def renew(self, lease_s: float) -> None:
        """Let all that have a lease last at least so long from now on."""
        ends_s = time.monotonic() + lease_s
        self._ends_s = {key: max(each, ends_s) for key, each in self._ends_s.items()}

    def left_s(self, machine: str, sensor: str) -> float | None:
        """Return how long a sensor stays overridden; None if only a release ends that."""
        ends_s = self._ends_s.get((machine, self._arrangement.slot_of(machine, sensor).name))
        return None if ends_s is None else max(0.0, ends_s - time.monotonic())

    def look(self) -> None:
        """Release the sensors whose overrides nobody has renewed."""
        for (machine, slot), ends_s in [*self._ends_s.items()]:
            if time.monotonic() > ends_s:
                self.end(machine, slot)
                for sensor in self._arrangement.overridden(machine):
                    if self._arrangement.slot_of(machine, sensor).name == slot:
                        what = "nobody renews the override: %s: %s is released"
                        logger().warning(what, machine, sensor)
                        self._arrangement.release(machine, sensor)
