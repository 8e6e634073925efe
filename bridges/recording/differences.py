"""What machines do differently when they run again, and how closely that is looked at."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import msgspec

from llfsm.runtime.journal.entries import FIELDS, Entry

__all__ = ["COMPARISONS", "Comparison", "Difference", "compared"]

Comparison: TypeAlias = Literal["all", "states", "posts"]
"""What is compared: every event and posted message, the states and those, or those alone."""

_TIMES: Final = {"reads", "time_ns", "duration_ns"}
_MARKS: Final = {"Overridden", "Released", "Plan", "Lost"}
_INPUTS: Final = {"Sensed", "Aged", "Answered", "Asked", "Loaded"}


def _without_times(kind: str) -> tuple[str, ...]:
    return tuple(name for name in FIELDS[kind] if name not in _TIMES)


_ALL: Final = {kind: _without_times(kind) for kind in FIELDS if kind not in _INPUTS | _MARKS}

COMPARISONS: Final[dict[Comparison, Mapping[str, tuple[str, ...]]]] = {
    "all": _ALL,
    "states": {
        kind: fields for kind, fields in _ALL.items() if kind not in ("Section", "Eval", "Call")
    },
    "posts": {
        "RoundBegin": (),
        "Turn": ("machine",),  # at which it learns what it learnt
        "Posted": _ALL["Posted"],
        "RoundEnd": (),
        "IdleSleep": (),
        "End": (),
    },
}
"""The kinds of entries that are compared, with the fields of each."""


def compared(entry: Entry, how: Comparison) -> dict[str, Any]:
    """Return the part of an entry that is compared."""
    fields = COMPARISONS[how].get(entry["event"], ())
    return {"event": entry["event"], **{name: entry[name] for name in fields}}


class Difference(NamedTuple):
    """The first thing that machines do differently; None where one of the two does nothing."""

    number: int
    """Its number among the recording's events and posts that are compared, from 1."""
    after_s: float
    """Seconds since the first event."""
    recorded: Entry | None
    found: Entry | None
    saw: Mapping[str, object] = {}
    """What the sensors of its machine had found."""

    def __str__(self) -> str:
        """Return both side by side, with a star where they differ, and what the machine saw."""
        both = [_shown(self.recorded), _shown(self.found)]
        names = dict.fromkeys(name for each in both for name in each)
        rows = [("", "recorded", "now")]
        for name in names:
            before, now = (each.get(name, "") for each in both)
            rows.append((f"{' ' if before == now else '*'} {name}", before, now))
        widths = [max(len(row[column]) for row in rows) for column in range(2)]
        lines = [f"event {self.number} differs, after {self.after_s:.6f} s:"]
        lines += [f"{a:{widths[0]}}  {b:{widths[1]}}  {c}".rstrip() for a, b, c in rows]
        machine = (self.recorded or self.found or {}).get("machine")
        lines += [f"{machine} saw {name} = {value!r}" for name, value in self.saw.items()]
        return "\n".join(lines)


def _shown(entry: Entry | None) -> dict[str, str]:
    if entry is None:
        return {"event": "nothing"}
    shown = {name: entry[name] for name in _without_times(entry["event"])}
    if entry["event"] == "Posted":
        shown["message"] = msgspec.msgpack.decode(shown["message"])
    return {"event": entry["event"], **{name: repr(value) for name, value in shown.items()}}
