"""The data that a page draws: frames of what has changed since the last one, and diagrams.

A frame has whatever differs between the newest snapshot and all that was sent before, by count,
identity or value. That needs no history of snapshots: a slow page gets fewer frames, each complete.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from functools import lru_cache
from operator import attrgetter
from typing import Any, cast

import msgspec

from llfsm.bridges.view.errors import RequestError
from llfsm.bridges.view.page_source import PageSource, Snapshot
from llfsm.runtime.drawing import Diagram, arrange
from llfsm.runtime.drawing.diagram import (
    Box,
    Edge,
    arrow_head,
    box_lines,
    inner_places,
    label_lines,
)
from llfsm.runtime.drawing.shapes import Text
from llfsm.runtime.engine.errors import DefinitionError
from llfsm.runtime.presence.published import table_of
from llfsm.runtime.presence.remote import condition_of, shown_fields
from llfsm.runtime.presence.slot_ownership import described, is_contested
from llfsm.whiteboard import Sample
from llfsm.whiteboard.liveness import identity
from llfsm.whiteboard.messages.llfsm import (
    DEFINITIONS,
    MACHINES,
    Commanders,
    MachineDefinition,
    MachineStatus,
)

SECTIONS: dict[str, bool | None] = {"auto": None, "shown": True, "hidden": False}


@lru_cache(maxsize=256)
def diagram_data(
    definition: MachineDefinition, title: str, sections: bool | None, *, unfold: bool
) -> dict[str, Any]:
    """Lay a machine out as `llfsm draw` does, as plain data; raise `RequestError`.

    To `unfold` it draws machines inside the states that run them.
    """
    find = _nothing if unfold else None
    try:
        diagram = arrange(table_of(definition), title=title, sections=sections, unfold=find)
    except DefinitionError as error:
        raise RequestError(f"{title} cannot be drawn: {error}") from error
    return plain_diagram(diagram) | {"unfolds": bool(definition.inner)}


def _nothing(_: str) -> None:
    """Find no machine by a name: what is known is in the definition."""


def plain_diagram(diagram: Diagram) -> dict[str, Any]:
    """Convert a diagram to plain data, as the page draws it; an overview has no start."""
    return {
        "title": diagram.title,
        "frame": (diagram.left, diagram.top, diagram.width, diagram.height),
        "start": {"curve": diagram.start, "head": arrow_head(diagram.start)}
        if diagram.start
        else None,
        "boxes": [_plain_box(box) for box in diagram.boxes],
        "edges": [_plain_edge(edge) for edge in diagram.edges],
    }


@lru_cache(maxsize=4096)
def _plain_box(box: Box) -> dict[str, Any]:
    return {
        "state": box.state,
        "frame": (box.left, box.top, box.width, box.height),
        "initial": box.initial,
        "accepting": box.accepting,
        "suspend": box.suspend,
        "slot": box.slot,
        "lines": _lines(box_lines(box)),
        "inner": [
            plain_diagram(each) | {"machine": each.machine, "place": (x - each.left, y - each.top)}
            for each, x, y in inner_places(box)
        ],
    }


@lru_cache(maxsize=4096)
def _plain_edge(edge: Edge) -> dict[str, Any]:
    label = edge.label
    return {
        "source": edge.source,
        "number": edge.number,
        "target": edge.target,
        "curve": edge.curve,
        "head": arrow_head(edge.curve),
        "label": {
            "frame": (
                label.x - label.width / 2, label.y - label.height / 2, label.width, label.height
            ),
            "lines": _lines(label_lines(label)),
        },
    }  # fmt: skip


def _lines(lines: Iterable[Text]) -> list[tuple[float, float, str, float, str, bool]]:
    return [(line.x, line.y, line.text, line.size, line.face, line.centred) for line in lines]


_encode = msgspec.json.Encoder().encode


class TimedEncoder:
    """Make frames with the time, in seconds since a page's first frame."""

    def __init__(self) -> None:
        self._base_ns: int | None = None

    def _seconds(self, stamp_ns: int) -> float:
        return (stamp_ns - (self._base_ns or 0)) / 1e9

    def _framed(self, now_ns: int, frame: dict[str, Any], *, beat: bool) -> bytes | None:
        """Return the frame as bytes; None if there is nothing in it and no `beat` is due."""
        if not frame and not beat:
            return None
        return _encode({"now": self._seconds(now_ns), **frame})


class FrameEncoder(TimedEncoder):
    """Encode what a page does not know yet.

    A frame is a JSON object. Members that are missing have not changed:

        now        seconds on the clock of all stamps; 0 is the page's first frame, or the
                   beginning of a recording
        speed      seconds that pass in a second: 1 live, 0 paused
        known      the time up to which the history of a recording is known
        reset      true: discard everything received before
        trouble    why there is nothing to show
        slots      [number, name, type, schema, capacity] of each new slot
        problems   why messages cannot be shown, by the slot's name
        contested  sentences about slots that several machines command
        samples    [slot's number, count, stamp, writer, fields' values]; without count: removed
        machines   by name, see `_machine`; null: removed
        history    new `Change`s, by machine
    """

    def __init__(self, source: PageSource) -> None:
        super().__init__()
        self._source = source
        self._epoch: int | None = None
        self._reset()

    def _reset(self) -> None:
        self._numbers: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._machines: dict[str, dict[str, Any]] = {}
        self._history_ns: dict[str, int] = {}  # the stamp of the last change sent
        self._slots: object = None
        self._rest: dict[str, Any] = {}

    def encode(self, snapshot: Snapshot, beat: bool) -> bytes | None:
        """Return the frame for a snapshot; None if nothing has changed and no `beat` is due."""
        player = self._source.player
        if self._base_ns is None:
            self._base_ns = snapshot.now_ns if player is None else player.span_ns[0]
        frame: dict[str, Any] = {}
        if snapshot.epoch != self._epoch:
            self._epoch = snapshot.epoch
            self._reset()
            frame["reset"] = True
        rest = {
            "speed": 1.0 if player is None else player.speed,
            "known": None if player is None else self._seconds(player.known_ns),
            "trouble": snapshot.trouble,
            "problems": dict(snapshot.problems),
            "contested": self._contested(snapshot),
        }
        frame |= {key: value for key, value in rest.items() if self._rest.get(key) != value}
        self._rest = rest
        if not snapshot.trouble:  # else the page keeps what it shows
            parts = {
                "slots": self._new_slots(snapshot),
                "samples": self._new_samples(snapshot),
                "machines": self._new_machines(snapshot),
                "history": self._new_history(),
            }
            frame |= {key: value for key, value in parts.items() if value}
        return self._framed(snapshot.now_ns, frame, beat=beat)

    def _new_slots(self, snapshot: Snapshot) -> list[Any]:
        if snapshot.slots is self._slots:
            return []
        self._slots = snapshot.slots
        new = []
        for name, info in snapshot.slots.items():
            if name not in self._numbers:
                self._numbers[name] = number = len(self._numbers)
                new.append((number, name, info.type_name, info.schema, info.capacity))
        return new

    def _new_samples(self, snapshot: Snapshot) -> list[Any]:
        counts, samples = self._counts, snapshot.samples
        new: list[Any] = []
        for name, sample in samples.items():
            if counts.get(name) != sample.count:
                counts[name] = sample.count
                stamp = self._seconds(sample.stamp_ns)
                new.append(
                    (self._numbers[name], sample.count, stamp, sample.writer, sample.message)
                )
        if len(counts) > len(samples):
            for name in counts.keys() - samples.keys():
                del counts[name]
                new.append((self._numbers[name],))
        return new

    def _new_machines(self, snapshot: Snapshot) -> dict[str, Any]:
        new: dict[str, Any] = {}
        for slot, sample in snapshot.samples.items():
            if isinstance(sample.message, MachineStatus):
                name = slot.removeprefix(MACHINES)
                machine = self._machine(name, sample, snapshot)
                if self._machines.get(name) != machine:
                    new[name] = self._machines[name] = machine
        for name in [name for name in self._machines if MACHINES + name not in snapshot.samples]:
            del self._machines[name]
            new[name] = None
        return new

    def _machine(self, name: str, sample: Sample[Any], snapshot: Snapshot) -> dict[str, Any]:
        status: MachineStatus = sample.message
        definition = snapshot.samples.get(DEFINITIONS + name)
        live = self._source.is_live(sample)
        silent_s = (snapshot.now_ns - sample.stamp_ns) / 1e9
        left_s = status.paused_left_s
        return {
            **shown_fields(status),
            "condition": condition_of(status, silent_s) if live else "ended",
            "ends": None if left_s is None else round(self._seconds(sample.stamp_ns) + left_s, 1),
            "overridden": [each.sensor for each in status.overridden],
            "entered": round(self._seconds(sample.stamp_ns) - status.in_state_s, 2),
            "definition": None if definition is None else definition.count,
        }

    def _contested(self, snapshot: Snapshot) -> list[str]:
        """Return a sentence for each slot that several live machines command."""
        messages = [sample.message for sample in snapshot.samples.values()]
        claims = [each for each in messages if isinstance(each, Commanders)]
        if not any(is_contested(each.commanders) for each in claims):
            return []
        live = set()
        for sample in snapshot.samples.values():
            status: Any = sample.message
            if isinstance(status, MachineStatus) and self._source.is_live(cast(Any, sample)):
                live.add(identity(status))
        sentences = []
        for each in claims:
            alive = [c for c in each.commanders if identity(c) in live or not c.machine]
            if is_contested(alive):
                sentences.append(described(each.slot, alive))
        return sentences

    def _new_history(self) -> dict[str, Any]:
        new = {}
        for name, changes in self._source.history().items():
            if changes and changes[-1].stamp_ns != self._history_ns.get(name):
                known_ns = self._history_ns.get(name, -1)
                first = bisect_right(changes, known_ns, key=attrgetter("stamp_ns"))
                self._history_ns[name] = changes[-1].stamp_ns
                new[name] = [
                    (self._seconds(change.stamp_ns), *change[1:]) for change in changes[first:]
                ]
        return new
