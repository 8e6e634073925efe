"""The states in which each machine was seen, for the timelines."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import cast

from llfsm.whiteboard import Message, Sample
from llfsm.whiteboard.messages.llfsm import MACHINES, MachineStatus

from .source import Change

__all__ = ["History"]

_MOST = 4_000  # changes of a machine that are kept
_GAP_NS = 1_000_000_000  # between two looks, after which nobody knows what was


class History:
    """Grow by what is seen of the machines; the oldest changes are forgotten."""

    def __init__(self) -> None:
        self.changes: dict[str, list[Change]] = {}
        self._noted_ns = 0

    def note(
        self,
        samples: Mapping[str, Sample[Message]],
        now_ns: int,
        is_live: Callable[[Sample[MachineStatus]], bool],
    ) -> None:
        """Add what has changed by the moment `now_ns`."""
        if now_ns - self._noted_ns > _GAP_NS:
            for changes in self.changes.values():
                if changes[-1].state:
                    unknown_ns = max(self._noted_ns, changes[-1].stamp_ns + 1)
                    changes.append(Change(unknown_ns, "", False))
        self._noted_ns = now_ns
        for name, told in samples.items():
            if not isinstance(told.message, MachineStatus):
                continue
            sample = cast("Sample[MachineStatus]", told)
            status = sample.message
            changes = self.changes.setdefault(name.removeprefix(MACHINES), [])
            last = changes[-1] if changes else Change(0, "", False)
            if not is_live(sample):
                change = Change(now_ns, "", False)
            else:
                entered_ns = sample.stamp_ns - round(status.in_state_s * 1e9)
                change = Change(max(entered_ns, last.stamp_ns + 1), status.state, status.suspended)
            if change[1:] != last[1:]:
                changes.append(change)
                if len(changes) > _MOST:
                    del changes[: _MOST // 2]
