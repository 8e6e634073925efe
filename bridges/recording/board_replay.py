"""From a recording back onto a whiteboard, in real time or step by step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from fnmatch import fnmatchcase
from typing import Any, Final, NamedTuple

from llfsm.runtime import Clock, MonotonicClock
from llfsm.whiteboard import Board, BoundSlot, Message
from llfsm.whiteboard.messages.fleet import viewer_slot
from llfsm.whiteboard.messages.llfsm import BELL, COMMANDERS, VIEWER, WILLS, request_slot

from .reader import RecordedMessage, RecordedSlot, Recording

__all__ = ["BoardReplay", "Posted", "ReplayStep"]

_SLICE_NS: Final = 50_000_000  # a wait is cut into these, to notice a request to end
_REQUESTS: Final = (BELL.name, VIEWER.name, viewer_slot("*").name, request_slot("*").name)


class Posted(NamedTuple):
    """A message that was replayed."""

    slot: str
    message: Message


class ReplayStep(NamedTuple):
    """A ringlet of a machine with the messages posted up to its end, or a single message."""

    now_ns: int
    """Time since the beginning of the recording."""
    text: str
    """The ringlet's machine, round, state and transition; empty in a recording without events."""
    posted: Sequence[Posted]
    moved: bool = False
    """Whether the machine entered its state, or a transition fired."""


class BoardReplay:
    """Post the messages of a recording to a board, in the order in which they were recorded.

    With `patterns`, only slots that match one of them are replayed; without, all but the slots of
    requests to machines. Last wills and claims to slots are never replayed. Raise
    :class:`.SlotTypeError` if the board has a slot with messages of another type.
    """

    def __init__(self, recording: Recording, board: Board, patterns: Sequence[str] = ()):
        self._recording = recording
        self._begin_ns, self._end_ns = recording.span_ns
        self._slots: dict[str, BoundSlot[Any]] = {
            name: board[each.slot]
            for name, each in recording.slots.items()
            if _wanted(name, patterns)
        }

    def play(
        self,
        is_over: Callable[[], bool],
        *,
        speed: float = 1.0,
        from_s: float = 0.0,
        clock: Clock | None = None,
    ) -> None:
        """Post from second `from_s` to the end, at `speed` times real time, or until `is_over`.

        The messages that were on the board at that second are posted first.
        """
        clock = clock or MonotonicClock()
        first_ns = self._begin_ns + round(from_s * 1e9)
        self._catch_up(first_ns)
        start_ns = clock.now_ns()
        for slot, recorded in self._recording.messages(self._slots.keys(), first_ns):
            due_ns = start_ns + round((recorded.seen_ns - first_ns) / speed)
            if not _wait(clock, due_ns, is_over):
                return
            self._post(slot, recorded)
        _wait(clock, start_ns + round((self._end_ns - first_ns) / speed), is_over)

    def steps(self, *, from_s: float = 0.0) -> Iterator[ReplayStep]:
        """Post in steps: the messages of a ringlet, or a message outside of any ringlet."""
        first_ns = self._begin_ns + round(from_s * 1e9)
        self._catch_up(first_ns)
        turn: ReplayStep | None = None  # the one in progress
        posted: list[Posted] = []  # in it
        states: dict[str, str] = {}
        for item in self._recording.timeline(self._slots.keys(), first_ns):
            since_ns = item.now_ns - self._begin_ns
            if item.slot is not None and item.recorded is not None:
                each = self._post(item.slot, item.recorded)
                if turn is None:
                    yield ReplayStep(since_ns, "", [each])
                else:
                    posted.append(each)
            elif item.entry is not None:
                entry = self._recording.entry(item.entry)
                if entry["event"] in ("Turn", "End") and turn is not None:
                    yield turn._replace(posted=posted)
                    turn, posted = None, []
                if entry["event"] == "Turn":
                    machine, state = entry["machine"], entry["state"]
                    moved = states.get(machine) != state
                    states[machine] = state
                    text = f"round {entry['round']}: {machine} in {state}"
                    turn = ReplayStep(since_ns, text, (), moved)
                elif entry["event"] == "Eval" and entry["value"] and turn is not None:
                    text = f"{turn.text}, {entry['label']}: to {entry['target']}"
                    turn = turn._replace(text=text, moved=True)
                    states[entry["machine"]] = entry["target"]
        if turn is not None:
            yield turn._replace(posted=posted)

    def _catch_up(self, first_ns: int) -> None:
        """Post the message that each slot held at a moment."""
        for name in self._slots:
            slot = self._recording.slots[name]
            latest = self._recording.latest(slot, first_ns - 1)
            if latest is not None:
                self._post(slot, latest)

    def _post(self, slot: RecordedSlot, recorded: RecordedMessage) -> Posted:
        name = slot.slot.name
        message = self._recording.message(slot, recorded)
        self._slots[name].add(message)
        return Posted(name, message)


def _wanted(name: str, patterns: Sequence[str]) -> bool:
    # A guard would execute a will, and claims would replace those of machines that live.
    if name.startswith((WILLS, COMMANDERS)):
        return False
    if patterns:
        return any(fnmatchcase(name, pattern) for pattern in patterns)
    return not any(fnmatchcase(name, pattern) for pattern in _REQUESTS)


def _wait(clock: Clock, due_ns: int, is_over: Callable[[], bool]) -> bool:
    """Wait until `due_ns`; return False if `is_over` becomes true before."""
    while not is_over():
        now_ns = clock.now_ns()
        if now_ns >= due_ns:
            return True
        clock.sleep_until_ns(min(due_ns, now_ns + _SLICE_NS))
    return False
