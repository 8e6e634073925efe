"""Messages of a recording, posted again: onto a board, or, of a bag, to machines that are rerun.

Onto a board they are posted in real time or step by step. A bag has no events of machines, so
nothing of a run can be repeated. But its topics are what machines read, and what machines posted
when it was recorded: so it is made a script for machines under a manual clock, and what they post
is compared with what it holds.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, Final, NamedTuple

from llfsm.bridges.recording.errors import RecordingError
from llfsm.bridges.recording.reader import RecordedMessage, RecordedSlot, Recording
from llfsm.runtime import Clock, ManualClock, MonotonicClock
from llfsm.runtime.journal.entries import Journal, entries_of
from llfsm.runtime.log import logger
from llfsm.runtime.testing.play import Loading, ScriptRun
from llfsm.runtime.testing.scripted import Step
from llfsm.whiteboard import Board, BoundSlot, Message, Slot
from llfsm.whiteboard.messages.llfsm import (
    BELL,
    COMMANDERS,
    VIEWER,
    WILLS,
    request_slot,
    viewer_slot,
)
from llfsm.whiteboard.schema import to_plain

_SLICE_NS: Final = 50_000_000  # a wait is cut into these, to notice a request to end
_MOST_ROUNDS: Final = 100  # at one time, for machines whose transitions always fire
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
    """True if the machine entered its state, or a transition fired."""


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
        gaps = _Gaps(self._recording, first_ns)
        for slot, recorded in self._recording.messages(self._slots.keys(), first_ns):
            due_ns = start_ns + round((gaps.without(recorded.seen_ns) - first_ns) / speed)
            if not _wait(clock, due_ns, is_over):
                return
            self._post(slot, recorded)
        end_ns = gaps.without(self._end_ns)
        _wait(clock, start_ns + round((end_ns - first_ns) / speed), is_over)

    def steps(self, *, from_s: float = 0.0) -> Iterator[ReplayStep]:
        """Post in steps, and yield each: the messages of a ringlet, or one outside of any."""
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


_LONGEST_GAP_NS = 600 * 1_000_000_000


class _Gaps:
    """Leave out what is beyond ten minutes of each time without a message, with a warning.

    A bag's first message may have the stamp 0, if nobody had set a simulated clock by then, and the
    next one that of today.
    """

    def __init__(self, recording: Recording, begin_ns: int):
        self._path = recording.path
        self._last_ns = begin_ns
        self._left_out_ns = 0

    def without(self, stamp_ns: int) -> int:
        """Return a time, not before the last one, as it is without the gaps up to it."""
        beyond_ns = stamp_ns - self._last_ns - _LONGEST_GAP_NS
        if beyond_ns > 0:
            self._left_out_ns += beyond_ns
            logger().warning(
                "%s: nothing in %s; 10 minutes of it are played",
                self._path,
                _duration_text(stamp_ns - self._last_ns),
            )
        self._last_ns = max(stamp_ns, self._last_ns)
        return stamp_ns - self._left_out_ns


def _duration_text(duration_ns: int) -> str:
    seconds = duration_ns / 1e9
    for unit, size in (("years", 31_557_600), ("days", 86_400), ("hours", 3600)):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds / 60:.0f} minutes"


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


class _Post(NamedTuple):
    """A message that was posted, as it is in a bag."""

    after_s: float
    data: bytes


class PostDifference(NamedTuple):
    """The first posted message that differs from the bag; None where one of the two has none."""

    slot: RecordedSlot
    number: int
    """Its number among the slot's messages, from 1, without those equal to the one before."""
    recorded: _Post | None
    found: _Post | None

    def __str__(self) -> str:
        """Show both, one below the other."""
        return "\n".join(
            (
                f"message {self.number} of {self.slot.slot.name} differs:",
                f"  recorded {self._shown(self.recorded)}",
                f"  now      {self._shown(self.found)}",
            )
        )

    def _shown(self, post: _Post | None) -> str:
        if post is None:
            return "nothing"
        plain = to_plain(self.slot.codec.decode(post.data))
        return f"after {post.after_s:.3f} s {json.dumps(plain, ensure_ascii=False)}"


class BagScript:
    """A script that posts a bag's messages to the slots `reads`, at their times.

    There are rounds at each message, and after `idle_ms` without one: one, and more at once while
    transitions fire. With `period_ms` single rounds are that far apart instead, and each sees the
    newest message. Of a time without messages, ten minutes are run at most. The bag is read anew,
    message by message, each time that the script is gone through: then
    :class:`.RecordingFileError` is raised for bytes that are no message.

    Raise :class:`.RecordingError` for a topic of another type than its slot, or if none of the
    slots is a topic.
    """

    def __init__(
        self,
        recording: Recording,
        reads: Mapping[str, Slot[Any]],
        *,
        idle_ms: float,
        period_ms: float | None,
    ):
        self._recording = recording
        self._reads = reads
        self._fed = [name for name in reads if name in recording.slots]
        if reads and not self._fed:
            raise RecordingError(
                f"{recording.path}: the machines read {', '.join(reads)}, but its topics are "
                f"{', '.join(recording.slots)}; --config says which slot a topic is"
            )
        for name in self._fed:
            held = recording.slots[name].slot
            if held.fingerprint != reads[name].fingerprint:
                raise RecordingError(f"{recording.path}: {reads[name].clash(held.schema)}")
        self._rest_ns = round((period_ms or idle_ms) * 1e6)
        self._is_paced = period_ms is not None

    def __iter__(self) -> Iterator[Step]:
        recording, rest_ns = self._recording, self._rest_ns
        now_ns, end_ns = recording.span_ns
        gaps = _Gaps(recording, now_ns)
        most_rounds = 1 if self._is_paced else _MOST_ROUNDS
        rest = Step(rest_ns / 1e6, most_rounds=most_rounds)
        new: dict[Slot[Any], Any] = {}
        for slot, recorded in recording.messages(self._fed):
            due_ns = gaps.without(recorded.seen_ns)
            while now_ns + rest_ns < due_ns:
                now_ns += rest_ns
                yield rest._replace(messages=new)
                new = {}
            new[self._reads[slot.slot.name]] = recording.message(slot, recorded)
            if not self._is_paced:
                yield Step((due_ns - now_ns) / 1e6, new, most_rounds=most_rounds)
                new, now_ns = {}, due_ns
        end_ns = gaps.without(end_ns)
        while new or now_ns < end_ns:  # what is left of it, in which machines may still post
            now_ns += rest_ns
            yield rest._replace(messages=new)
            new = {}


class BagRerun:
    """Rerun machines on a bag's script, once, and compare their messages to the slots `posts`.

    The messages of each slot are compared in their order. Their times are not, and a message that
    is equal to the one before counts once, as a relay may leave it out. The machines' last
    messages, `at_end`, need not be in the bag: it may end before the machines did.
    """

    def __init__(self, recording: Recording, posts: Iterable[str]):
        self._slots = {name: recording.slots[name] for name in posts if name in recording.slots}
        self._expected = {name: _distinct(recording, slot) for name, slot in self._slots.items()}
        self._latest: dict[str, bytes] = {}
        self._clock = ManualClock()
        self._ended = False
        self.rounds = 0
        """The number of rounds that the machines have run."""
        self.compared = dict.fromkeys(self._slots, 0)
        """By slot that is a topic of the bag, the number of messages that were as recorded."""
        self.difference: PostDifference | None = None

    def compare(
        self, members: Iterable[Loading], script: Iterable[Step], *, unload_accepting: bool = True
    ) -> PostDifference | None:
        """Run `members`; return the first difference, or None.

        Raise :class:`.ExecutionError` if code of a machine raises.
        """
        journal = Journal(self._take)
        run = ScriptRun(members, unload_accepting=unload_accepting, journal=journal)
        self._clock = run.scripted.clock
        for _ in run.play(script):
            journal.flush()
            if self.difference is not None or run.arrangement.finished:
                break
        if run.error is not None:
            raise run.error
        self._ended = True
        self.rounds = run.arrangement.rounds
        run.arrangement.end()
        for name in self._slots:
            self._check(name, None)
        return self.difference

    def _take(self, data: bytes) -> None:
        for entry in entries_of(data):
            if entry["event"] != "Posted" or entry["slot"] not in self._slots:
                continue
            name, slot = entry["slot"], self._slots[entry["slot"]]
            posted = slot.codec.encode(slot.slot.decoder.decode(entry["message"]))
            if posted != self._latest.get(name):
                self._latest[name] = posted
                self._check(name, _Post(self._clock.now_ns() / 1e9, posted))

    def _check(self, name: str, found: _Post | None) -> None:
        if self.difference is not None:
            return
        recorded = next(self._expected[name], None)
        if recorded is None and self._ended:
            return
        if recorded is not None and found is not None and recorded.data == found.data:
            self.compared[name] += 1
            return
        number = self.compared[name] + 1
        self.difference = PostDifference(self._slots[name], number, recorded, found)


def _distinct(recording: Recording, slot: RecordedSlot) -> Iterator[_Post]:
    """Yield the messages of a slot without those equal to the one before."""
    latest: bytes | None = None
    begin_ns = recording.span_ns[0]
    for _, recorded in recording.messages((slot.slot.name,)):
        data = slot.codec.encode(recording.message(slot, recorded))
        if data != latest:
            latest = data
            yield _Post((recorded.seen_ns - begin_ns) / 1e9, data)
