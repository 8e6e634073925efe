"""The overview of an arrangement: its machines, the slots that they share, and their requests."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from ..engine.machine import Machine
from ..engine.ports import Actuator, Sensor
from .arrange import framed
from .automatic_layout import automatic_layout
from .diagram import Arrow, Diagram
from .typeset import make_box, make_label

__all__ = ["MachineLinks", "links_of", "overview"]


class MachineLinks(NamedTuple):
    """What a machine has to do with others: the slots that it reads and posts, and its requests.

    A request is what is asked, as "suspend", and the name of the machine that is asked.
    """

    reads: Sequence[str] = ()
    posts: Sequence[str] = ()
    requests: Sequence[tuple[str, str]] = ()


def links_of(
    cls: type[Machine], slots: Mapping[str, str], requests: Sequence[tuple[str, str]]
) -> MachineLinks:
    """Return the links of a machine that makes `requests` and is loaded with other `slots`."""

    def names(ports: Mapping[str, Sensor[Any, Any] | Actuator[Any]]) -> list[str]:
        return [slots.get(port.slot.name, port.slot.name) for port in ports.values()]

    return MachineLinks(names(cls.table.sensors), names(cls.table.actuators), requests)


def overview(title: str, machines: Mapping[str, MachineLinks]) -> Diagram:
    """Return a drawing of machines and slots: arrows lead where messages and requests go.

    A machine that is only asked, as one that others load, is drawn, too. Equal machines give equal
    diagrams.
    """
    asked = [name for each in machines.values() for _, name in each.requests]
    names = list(dict.fromkeys([*machines, *asked]))
    slots = list(dict.fromkeys(s for m in machines.values() for s in (*m.posts, *m.reads)))
    machine_at = {name: i for i, name in enumerate(names)}
    slot_at = {slot: len(names) + i for i, slot in enumerate(slots)}
    kinds = {"initial": False, "accepting": False, "suspend": False}
    boxes = [make_box(name, (), **kinds) for name in names]
    boxes += [replace(make_box(slot, (), **kinds), slot=True) for slot in slots]
    found: list[tuple[int, int, str]] = []
    for name, each in machines.items():
        here = machine_at[name]
        asks: dict[str, list[str]] = {}
        for what, other in each.requests:
            asks.setdefault(other, []).append(what)
        found += [(here, slot_at[slot], "posts") for slot in dict.fromkeys(each.posts)]
        found += [(slot_at[slot], here, "reads") for slot in dict.fromkeys(each.reads)]
        found += [
            (here, machine_at[other], ", ".join(dict.fromkeys(what)))
            for other, what in asks.items()
        ]
    numbers: Counter[int] = Counter()
    arrows = []
    for source, target, label in found:
        arrows.append(Arrow(source, numbers[source], target, make_label(label)))
        numbers[source] += 1
    placed, edges = automatic_layout(boxes, arrows)
    return framed(title, placed, edges, ())
