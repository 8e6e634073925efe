"""Which transitions the machines of a recording had evaluated last, at any of its moments.

A journal has the value of each guard that was evaluated. With what the guard saw, there is more to
be known: :mod:`.explaining` runs the machines again for that.
"""

from __future__ import annotations

from collections import defaultdict
from contextlib import suppress
from typing import Any, Final

from llfsm.whiteboard.messages.debugging import MachineWhy, SeenTransition

from .errors import RecordingFileError
from .reader import RecordedJournal, Recording

__all__ = ["causes_at"]

_KIND_BYTES: Final = 24  # at the beginning of an entry, which contain its kind
_MOST: Final = 10_000  # entries that are looked at


def causes_at(recording: Recording, journal: RecordedJournal, now_ns: int) -> dict[str, MachineWhy]:
    """Return why each machine of a journal is where it is, by its last turn before that moment."""
    evaluated: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)  # the last one first
    found: dict[str, MachineWhy] = {}
    rounds = 0
    for number, record in enumerate(recording.backwards(journal, now_ns)):
        kind = record.data[:_KIND_BYTES]
        rounds += b'"RoundBegin"' in kind
        if rounds > 1 or number == _MOST:  # each machine has had its turn in a whole round
            break
        if b'"Eval"' not in kind and b'"Turn"' not in kind:
            continue
        with suppress(RecordingFileError):
            entry = recording.entry(record)
            machine = entry["machine"]
            if machine in found:
                continue
            if entry["event"] == "Eval":
                evaluated[machine].append(entry)
            else:
                evaluated_s = (now_ns - recording.time_of(record)) / 1e9
                found[machine] = _why(entry["state"], evaluated[machine][::-1], evaluated_s)
    return found


def _why(state: str, evaluated: list[dict[str, Any]], evaluated_s: float) -> MachineWhy:
    seen = tuple(
        SeenTransition(each["target"], each["label"], each["value"], each["label"])
        for each in evaluated
    )
    if seen and seen[-1].value is True:
        return MachineWhy(seen[-1].target, (), state, seen)
    return MachineWhy(state, seen, evaluated_s=evaluated_s if seen else None)
