"""The interface of a page's data source: a live board or a recording.

The server takes a snapshot up to thirty times a second while any page is open, and sends each page
what has changed since its last frame. A source therefore has no events and no queue: it returns the
state of everything at one moment.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from llfsm.whiteboard import Message, Sample
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.messages.llfsm import MachineStatus

if TYPE_CHECKING:
    from llfsm.whiteboard import Board

    from .notes import Note

__all__ = ["Change", "PageSource", "Player", "Snapshot"]


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
    """What a page shows. All methods are called from one thread, and none blocks."""

    title: str
    """The page's heading: the name of a board or a file."""
    player: Player | None = None
    """The playback; None if the source is live."""

    @abstractmethod
    def snapshot(self) -> Snapshot:
        """Return the state of everything; never raise because of what a board or file holds."""

    @abstractmethod
    def is_live(self, sample: Sample[MachineStatus]) -> bool:
        """Return whether a machine was loaded by a live process at the latest snapshot."""

    @abstractmethod
    def history(self) -> Mapping[str, Sequence[Change]]:
        """Return the known changes of each machine, by name, ordered by time.

        For a live board they begin with the first snapshot, for a recording with its beginning. The
        stamps of a machine's changes increase strictly; later changes are appended.
        """

    @abstractmethod
    def notes(self) -> Sequence[Note]:
        """Return what else has happened to machines, as far as `history` is known, by time."""

    def board(self) -> Board | None:
        """Return the board on which machines and slots are controlled, or None."""
        return None

    @abstractmethod
    def close(self) -> None:
        """Release the source; closing twice is fine."""
