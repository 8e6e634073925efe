"""The states in which each machine was seen, for the timelines."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import cast

from llfsm.whiteboard import Message, Sample
from llfsm.whiteboard.messages.llfsm import MACHINES, MachineStatus

from .source import Change

__all__ = ["History", "Track"]

_MOST = 4_000  # changes of a machine that are kept
_GAP_NS = 1_000_000_000  # between two looks, after which nobody knows what was


class Track:
    """The states of one machine, as far as they are told; stamps increase strictly."""

    def __init__(self) -> None:
        self.changes: list[Change] = []
        self._entered_ns = 0

    def tell(self, sample: Sample[MachineStatus]) -> None:
        """Add what a status says."""
        status = sample.message
        last = self.changes[-1] if self.changes else Change(0, "", False)
        # Before its turn in a state it has no time there: then comes the same stay's.
        again = 0 < self._entered_ns != status.entered_ns > 0
        self._entered_ns = status.entered_ns
        if again or (status.state, status.suspended) != (last.state, last.suspended):
            began_ns = sample.stamp_ns - round(status.in_state_s * 1e9)
            skipped = bool(status.source and last.state) and status.source != last.state
            way = status.source, status.transition, skipped
            self.add(Change(began_ns, status.state, status.suspended, *way))

    def add(self, change: Change) -> None:
        """Add a change, after the one before."""
        before_ns = self.changes[-1].stamp_ns if self.changes else -1
        self.changes.append(change._replace(stamp_ns=max(change.stamp_ns, before_ns + 1)))

    def lose(self, now_ns: int) -> None:
        """Add that it is gone, or that nobody knows how it is."""
        self._entered_ns = 0
        if self.changes and self.changes[-1].state:
            self.add(Change(now_ns, "", False))


class History:
    """Grow by what is seen of the machines; the oldest changes are forgotten."""

    def __init__(self) -> None:
        self.changes: dict[str, list[Change]] = {}
        self._tracks: dict[str, Track] = {}
        self._noted_ns = 0

    def note(
        self,
        samples: Mapping[str, Sample[Message]],
        now_ns: int,
        is_live: Callable[[Sample[MachineStatus]], bool],
    ) -> None:
        """Add what has changed by the moment `now_ns`."""
        if now_ns - self._noted_ns > _GAP_NS:
            for track in self._tracks.values():
                track.lose(self._noted_ns)
        self._noted_ns = now_ns
        for slot, told in samples.items():
            if not isinstance(told.message, MachineStatus):
                continue
            sample, name = cast("Sample[MachineStatus]", told), slot.removeprefix(MACHINES)
            if name not in self._tracks:
                self._tracks[name] = Track()
                self.changes[name] = self._tracks[name].changes
            track = self._tracks[name]
            if is_live(sample):
                track.tell(sample)
            else:
                track.lose(now_ns)
            if len(track.changes) > _MOST:
                del track.changes[: _MOST // 2]
