"""The states in which each machine was seen, for the timelines."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import cast

from llfsm.whiteboard import Message, Sample
from llfsm.whiteboard.messages.llfsm import MACHINES, MachineStatus

from .page_source import Change

__all__ = ["StateHistory", "Track"]

_MOST_CHANGES = 4_000  # of a machine
_GAP_NS = 1_000_000_000  # between two snapshots: longer, and the states between are unknown


class Track:
    """The states of one machine, as far as they are published; stamps increase strictly."""

    def __init__(self) -> None:
        self.changes: list[Change] = []
        self._entered_ns = 0

    def update(self, sample: Sample[MachineStatus]) -> None:
        """Add the state of a published status, if it is new."""
        status = sample.message
        last = self.changes[-1] if self.changes else Change(0, "", False)
        # A status before the first turn in a state has no time of entry; the next one of it has.
        again = 0 < self._entered_ns != status.entered_ns > 0
        self._entered_ns = status.entered_ns
        now = status.state, status.suspended, status.failed
        if again or now != (last.state, last.suspended, last.failed):
            since_s = status.in_state_s
            if not again and status.state == last.state:  # it was suspended, resumed, or has failed
                since_s = status.error_s if status.failed else 0.0
            began_ns = sample.stamp_ns - round(since_s * 1e9)
            skipped = bool(status.source and last.state) and status.source != last.state
            way = status.source, status.transition, skipped
            self.add(Change(began_ns, status.state, status.suspended, *way, status.failed))

    def add(self, change: Change) -> None:
        """Add a change; its stamp is made later than the one before."""
        before_ns = self.changes[-1].stamp_ns if self.changes else -1
        self.changes.append(change._replace(stamp_ns=max(change.stamp_ns, before_ns + 1)))

    def lose(self, now_ns: int) -> None:
        """Add that the machine has ended, or that its state is unknown."""
        self._entered_ns = 0
        if self.changes and self.changes[-1].state:
            self.add(Change(now_ns, "", False))


class StateHistory:
    """Collect the states in successive snapshots; the oldest changes are dropped."""

    def __init__(self) -> None:
        self.changes: dict[str, list[Change]] = {}
        self._tracks: dict[str, Track] = {}
        self._latest_ns = 0

    def add(
        self,
        samples: Mapping[str, Sample[Message]],
        now_ns: int,
        is_live: Callable[[Sample[MachineStatus]], bool],
    ) -> None:
        """Add what has changed in the samples at `now_ns`."""
        if now_ns - self._latest_ns > _GAP_NS:
            for track in self._tracks.values():
                track.lose(self._latest_ns)
        self._latest_ns = now_ns
        for slot, each in samples.items():
            if not isinstance(each.message, MachineStatus):
                continue
            sample, name = cast("Sample[MachineStatus]", each), slot.removeprefix(MACHINES)
            if name not in self._tracks:
                self._tracks[name] = Track()
                self.changes[name] = self._tracks[name].changes
            track = self._tracks[name]
            if is_live(sample):
                track.update(sample)
            else:
                track.lose(now_ns)
            if len(track.changes) > _MOST_CHANGES:
                del track.changes[: _MOST_CHANGES // 2]
