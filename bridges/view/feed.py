"""What one page is told: of each look, what has changed since the last one it was told of.

Nothing is queued: a page that is slow is told less often, and always of the newest look.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import Any

import msgspec

from llfsm.runtime.presence.remote import SILENT_S
from llfsm.whiteboard import Sample
from llfsm.whiteboard.messages.llfsm import DEFINITIONS, MACHINES, MachineStatus

from .source import Change, Look, Source

__all__ = ["Feed"]

_encode = msgspec.json.Encoder().encode


class Feed:
    """Remember what a page knows, and tell it the rest.

    A frame is a JSON object; what it lacks has not changed:

        now        seconds on the clock of all stamps, which begins at the page's first look, or
                   with a recording
        speed      seconds that pass in a second: 1 live, 0 paused
        known      up to when the history of a recording is known
        reset      true: forget all before
        trouble    why there is nothing to look at
        slots      [number, name, type, schema, capacity] of each new slot
        problems   why messages cannot be shown, by name of the slot
        samples    [slot's number, count, stamp, writer, fields' values]; no count: none any more
        machines   by name; see `_machine`
        history    each `Change`, by machine
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._base_ns: int | None = None
        self._epoch: int | None = None
        self._forget()

    def _forget(self) -> None:
        self._numbers: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._machines: dict[str, dict[str, Any]] = {}
        self._told: dict[str, int] = {}
        self._slots: object = None
        self._rest: dict[str, Any] = {}

    def frame(self, look: Look, *, beat: bool) -> bytes | None:
        """Return what makes the page know `look`; None if it does, and no `beat` is due."""
        player = self._source.player
        if self._base_ns is None:
            self._base_ns = look.now_ns if player is None else player.span_ns[0]
        frame: dict[str, Any] = {}
        if look.epoch != self._epoch:
            self._epoch = look.epoch
            self._forget()
            frame["reset"] = True
        rest = {
            "speed": 1.0 if player is None else player.speed,
            "known": None if player is None else self._seconds(player.known_ns),
            "trouble": look.trouble,
            "problems": dict(look.problems),
        }
        frame |= {key: value for key, value in rest.items() if self._rest.get(key) != value}
        self._rest = rest
        if not look.trouble:  # else what was there last stays on the page
            parts = {
                "slots": self._new_slots(look),
                "samples": self._new_samples(look),
                "machines": self._new_machines(look),
                "history": self._new_history(),
            }
            frame |= {key: value for key, value in parts.items() if value}
        if not frame and not beat:
            return None
        return _encode({"now": self._seconds(look.now_ns), **frame})

    def _seconds(self, stamp_ns: int) -> float:
        return (stamp_ns - (self._base_ns or 0)) / 1e9

    def _new_slots(self, look: Look) -> list[Any]:
        if look.slots is self._slots:
            return []
        self._slots = look.slots
        new = []
        for name, info in look.slots.items():
            if name not in self._numbers:
                self._numbers[name] = number = len(self._numbers)
                new.append((number, name, info.type_name, info.schema, info.capacity))
        return new

    def _new_samples(self, look: Look) -> list[Any]:
        counts, samples = self._counts, look.samples
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

    def _new_machines(self, look: Look) -> dict[str, Any]:
        new: dict[str, Any] = {}
        for slot, sample in look.samples.items():
            if isinstance(sample.message, MachineStatus):
                name = slot.removeprefix(MACHINES)
                machine = self._machine(name, sample, look)
                if self._machines.get(name) != machine:
                    new[name] = self._machines[name] = machine
        for name in [name for name in self._machines if MACHINES + name not in look.samples]:
            del self._machines[name]
            new[name] = None
        return new

    def _machine(self, name: str, sample: Sample[Any], look: Look) -> dict[str, Any]:
        status: MachineStatus = sample.message
        definition = look.samples.get(DEFINITIONS + name)
        if not self._source.is_live(sample):
            condition = "ended"
        elif look.now_ns - sample.stamp_ns > SILENT_S * 1e9:
            condition = "silent"
        else:
            condition = "suspended" if status.suspended else "running"
        return {
            "condition": condition,
            "state": status.state,
            "suspended": status.suspended,
            "pending": status.pending,
            "ringlets": status.ringlets,
            "overruns": status.overruns,
            "entered": round(self._seconds(sample.stamp_ns) - status.in_state_s, 2),
            "pid": status.pid,
            "host": status.host,
            "definition": None if definition is None else definition.count,
        }

    def _new_history(self) -> dict[str, Any]:
        new = {}
        for name, changes in self._source.history().items():
            if changes and changes[-1].stamp_ns != self._told.get(name):
                first = bisect_right(changes, self._told.get(name, -1), key=_stamp_ns)
                self._told[name] = changes[-1].stamp_ns
                new[name] = [
                    (self._seconds(change.stamp_ns), *change[1:]) for change in changes[first:]
                ]
        return new


def _stamp_ns(change: Change) -> int:
    return change.stamp_ns
