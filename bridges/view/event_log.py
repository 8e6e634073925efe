"""The event log of the page: what machines did and what happened to them, the newest first."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from heapq import merge
from itertools import islice
from typing import Any, Final, NamedTuple

from llfsm.whiteboard import Sample
from llfsm.whiteboard.messages.llfsm import DEFINITIONS, MachineDefinition

from .notes import Note
from .page_source import Change

__all__ = ["LogPage", "log_page"]

_LOOKED_AT: Final = 50  # events for each one that is asked for: a page must not wait for long


class LogPage(NamedTuple):
    """The newest events, and whether these are all."""

    events: list[Note]
    complete: bool


def log_page(
    history: Mapping[str, Sequence[Change]],
    notes: Sequence[Note],
    samples: Mapping[str, Sample[Any]],
    *,
    words: str = "",
    until_ns: int | None = None,
    most: int = 200,
) -> LogPage:
    """Return up to `most` events until a time that have all the words, the newest first.

    The labels of transitions are in the definitions among the samples.
    """
    wanted = words.lower().split()
    ways = [_changes(name, each, samples, until_ns) for name, each in history.items()]
    end = len(notes) if until_ns is None else bisect_right(notes, until_ns, key=_stamp_ns)
    # Without an end, these may grow, or lose their oldest, only after this function has returned.
    newest = merge(*ways, (notes[i] for i in range(end - 1, -1, -1)), key=_stamp_ns, reverse=True)
    looked_at = islice(newest, _LOOKED_AT * most)
    found = list(islice((each for each in looked_at if _has(each, wanted)), most))
    return LogPage(found, next(newest, None) is None)


def _has(event: Note, wanted: Sequence[str]) -> bool:
    text = f"{event.machine} {event.kind} {event.text}".lower()
    return all(word in text for word in wanted)


def _stamp_ns(event: Note | Change) -> int:
    return event.stamp_ns


def _changes(
    machine: str,
    changes: Sequence[Change],
    samples: Mapping[str, Sample[Any]],
    until_ns: int | None,
) -> Iterator[Note]:
    """Return a machine's changes as events, the latest first."""
    sample = samples.get(DEFINITIONS + machine)
    definition = None if sample is None else sample.message
    labels = {}
    if isinstance(definition, MachineDefinition):
        for state in definition.states:
            for number, each in enumerate(state.transitions):
                labels[state.name, number] = each.label
    end = len(changes) if until_ns is None else bisect_right(changes, until_ns, key=_stamp_ns)
    for i in range(end - 1, -1, -1):
        change, before = changes[i], changes[i - 1] if i else None
        if not change.failed:  # there is a note of it, which says why
            kind, text = _described(change, before, labels)
            yield Note(change.stamp_ns, machine, kind, text)


def _described(
    change: Change, before: Change | None, labels: Mapping[tuple[str, int], str]
) -> tuple[str, str]:
    """Return the kind and the text of a change."""
    if not change.state:
        return "ended", "ended"
    if change.suspended:
        return "suspended", f"suspended in {change.state}"
    if before is not None and before.suspended:
        return "resumed", f"resumed in {change.state}"
    if not change.source:
        return "state", f"in {change.state}"
    label = labels.get((change.source, change.transition), "")
    text = f"{change.source} → {change.state}  {label}".rstrip()
    return "transition", f"… {text}" if change.skipped else text
