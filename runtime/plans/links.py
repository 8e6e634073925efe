"""What a machine of a plan has to do with others, for an overview of its arrangement."""

from __future__ import annotations

from ..checking import requests_of
from ..drawing.overview import MachineLinks
from ..engine.machine import Machine
from .plan import PlannedMachine

__all__ = ["links_of"]


def links_of(cls: type[Machine], planned: PlannedMachine) -> MachineLinks:
    """Return what a machine reads and posts when it is loaded as planned, and its requests."""
    slots, table = planned.slots, cls.table
    return MachineLinks(
        [slots.get(each.slot.name, each.slot.name) for each in table.sensors.values()],
        [slots.get(each.slot.name, each.slot.name) for each in table.actuators.values()],
        requests_of(cls, planned.variables),
    )
