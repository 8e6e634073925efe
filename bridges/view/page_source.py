"""The interface of a page's data source: a live board or a recording.

The server takes a snapshot up to thirty times a second while any page is open, and sends each page
what has changed since its last frame. A source therefore has no events and no queue: it returns the
state of everything at one moment. `Notes` derives events from successive statuses and requests; of
several changes between two of them, only the last is known.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import insort
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

from llfsm.whiteboard import Message, Sample
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.messages.llfsm import MachineRequest, MachineStatus

if TYPE_CHECKING:
    from llfsm.whiteboard import Board


_MOST: Final = 10_000
_SAME_NS: Final = 300_000_000  # within which all machines of a process publish the same pause


class Note(NamedTuple):
    """Something that has happened to a machine; `kind` is one word for it."""

    stamp_ns: int
    machine: str
    kind: str
    text: str


class Notes:
    """Collect requests to machines, failures, pauses and overrides; the oldest are dropped."""

    def __init__(self) -> None:
        self.all: list[Note] = []
        """Ordered by time."""
        self._statuses: dict[str, MachineStatus] = {}
        self._counts: dict[str, int] = {}
        self._pauses: dict[tuple[str, int, str], int] = {}

    def take_status(self, machine: str, sample: Sample[MachineStatus]) -> None:
        """Note what is new in a machine's status."""
        status, stamp_ns = sample.message, sample.stamp_ns
        before = self._statuses.get(machine, MachineStatus())
        if status is before:
            return
        if not status.loaded:
            self._statuses.pop(machine, None)
            return
        self._statuses[machine] = status
        if status.failed and (not before.failed or status.error != before.error):
            failed_ns = stamp_ns - round(status.error_s * 1e9)
            self._add(Note(failed_ns, machine, "failed", f"failed: {status.error}"))
        if status.hung and not before.hung:
            self._add(Note(stamp_ns, machine, "failed", f"hangs: {status.error}"))
        if status.paused != before.paused:
            text = f"paused: {status.paused}" if status.paused else "continued"
            key = status.host, status.pid, text
            if abs(stamp_ns - self._pauses.get(key, -_SAME_NS)) >= _SAME_NS:
                self._pauses[key] = stamp_ns
                self._add(Note(stamp_ns, machine, "paused", text))
        now, then = ({each.sensor for each in one.overridden} for one in (status, before))
        for sensor in sorted(now ^ then):
            what = "overridden" if sensor in now else "released"
            self._add(Note(stamp_ns, machine, "override", f"{sensor} is {what}"))
        if status.refusal and status.refusal != before.refusal:
            self._add(Note(stamp_ns, machine, "request", f"not reloaded: {status.refusal}"))

    def take_request(self, machine: str, sample: Sample[MachineRequest]) -> None:
        """Note a request, unless it is known or only renews a pause."""
        request = sample.message
        if self._counts.get(machine) == sample.count:
            return
        self._counts[machine] = sample.count
        if request.action != "renew":
            text = f"request: {request.action} {request.argument}".rstrip()
            self._add(Note(sample.stamp_ns, machine, "request", text))

    def _add(self, note: Note) -> None:
        insort(self.all, note, key=lambda each: each.stamp_ns)
        if len(self.all) > _MOST:
            del self.all[: _MOST // 2]


class Change(NamedTuple):
    """A machine has changed its state, has failed, or was suspended or resumed.

    `state` is empty while the machine is not running or its state is unknown. `source` and
    `transition` are the state and number of the transition taken, if known. `skipped`: states in
    between were too short to be seen. `failed`: it is suspended because its code has raised.
    """

    stamp_ns: int
    state: str
    suspended: bool
    source: str = ""
    transition: int = 0
    skipped: bool = False
    failed: bool = False


class Snapshot(NamedTuple):
    """The state of everything at one moment.

    Samples are compared by their counts. `epoch` is a new number whenever counts cannot be compared
    with earlier ones: after the board was made again, or after a seek in a recording.
    """

    now_ns: int
    """The moment, on the clock of the samples' stamps."""
    epoch: int
    slots: Mapping[str, SlotInfo]
    """By name, in the order in which they were made."""
    samples: Mapping[str, Sample[Message]]
    """The latest of each slot that has one, of the class that `poller.class_of` returns."""
    problems: Mapping[str, str] = {}
    """Why messages cannot be shown, by the slot's name."""
    trouble: str = ""
    """Why there is nothing to show, in a sentence with the remedy; else empty."""


class Player(ABC):
    """The playback of a source that is not live."""

    span_ns: tuple[int, int]
    """The first and the last moment, on the clock of the samples' stamps."""
    known_ns: int
    """The time up to which the source's `history` is known so far."""
    speed: float = 0.0
    """Seconds that pass in a second; 0 while paused."""

    @abstractmethod
    def seek(self, now_ns: int) -> None:
        """Move to a moment of the span."""

    @abstractmethod
    def play(self, speed: float) -> None:
        """Play from here at `speed` times real time; 0 pauses. Playback pauses at the end."""


class PageSource(ABC):
    """The data of a page. All methods are called from one thread, and none blocks."""

    title: str
    """The page's heading: the name of a board or a file."""
    player: Player | None = None
    """The playback; None if the source is live."""

    @abstractmethod
    def snapshot(self) -> Snapshot:
        """Return the state of everything; never raise because of what a board or file holds."""

    @abstractmethod
    def is_live(self, sample: Sample[MachineStatus]) -> bool:
        """Check that a machine was loaded by a live process at the latest snapshot."""

    @abstractmethod
    def history(self) -> Mapping[str, Sequence[Change]]:
        """Return the known changes of each machine, by name, ordered by time.

        For a live board they begin with the first snapshot, for a recording with its beginning. The
        stamps of a machine's changes increase strictly; later changes are appended.
        """

    @abstractmethod
    def notes(self) -> Sequence[Note]:
        """Return the notes on machines, as far as `history` is known, by time."""

    def board(self) -> Board | None:
        """Return the board on which machines and slots are controlled, or None."""
        return None

    @abstractmethod
    def close(self) -> None:
        """Release the source; closing twice is fine."""
