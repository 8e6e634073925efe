"""Where a page's data come from: the interface of a live board and of a recording.

The server looks at its source up to thirty times a second, as long as somebody has the page open,
and tells each page what has changed since it was last told. A source therefore has no events and
no queue: it answers how everything is at one moment.
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

__all__ = ["Change", "Look", "Player", "Source"]


class Change(NamedTuple):
    """A machine in another state than before, or suspended or resumed; without a state: gone.

    So it is, too, while nobody looks. It has come there by number `transition` of state `source`,
    if that is known. `skipped`: states in between were too short to be seen.
    """

    stamp_ns: int
    state: str
    suspended: bool
    source: str = ""
    transition: int = 0
    skipped: bool = False


class Look(NamedTuple):
    """All that there is at one moment.

    Samples are compared by their counts, and `epoch` is another number whenever counts cannot be
    compared with earlier ones: the board was made anew, or a recording was left and entered
    elsewhere.
    """

    now_ns: int
    """On the clock of the samples' stamps."""
    epoch: int
    slots: Mapping[str, SlotInfo]
    """By name, in the order in which they were made."""
    samples: Mapping[str, Sample[Message]]
    """The latest of each slot that has one, of the class that `poller.class_of` returns."""
    problems: Mapping[str, str] = {}
    """By name of the slot: why its messages cannot be shown."""
    trouble: str = ""
    """Why there is nothing to look at, in a sentence that says what to do; empty if there is."""


class Player(ABC):
    """The time slider of a source that is no live one."""

    span_ns: tuple[int, int]
    """The first and the last moment, on the clock of the samples' stamps."""
    known_ns: int
    """Up to when the source's `history` is known so far."""
    speed: float = 0.0
    """Seconds that pass in a second; 0 stands still."""

    @abstractmethod
    def seek(self, now_ns: int) -> None:
        """Go to a moment of the span."""

    @abstractmethod
    def play(self, speed: float) -> None:
        """Let time pass from here, `speed` times as fast; 0 pauses. It pauses at the end."""


class Source(ABC):
    """What a page shows. All methods are called from one thread, and none waits."""

    title: str
    """As the page's heading: a board's name, a file's."""
    player: Player | None = None
    """The time slider; None if the source is live."""

    @abstractmethod
    def look(self) -> Look:
        """Return how everything is; never raise because of what a board or file holds."""

    @abstractmethod
    def is_live(self, sample: Sample[MachineStatus]) -> bool:
        """Tell whether a machine was loaded, by a process that lived, at the latest look."""

    @abstractmethod
    def history(self) -> Mapping[str, Sequence[Change]]:
        """Return what is known of each machine's states, by name, in order of time.

        Of a live board since the first look, of a recording from its beginning to its end. The
        stamps of a machine's changes increase strictly; what is added later is added at the end.
        """

    def board(self) -> Board | None:
        """Return the board on which machines and slots are controlled, or None if there is none."""
        return None

    @abstractmethod
    def close(self) -> None:
        """Let go of it; closing twice is fine."""
