"""What a relay sends when the process is lost that has posted its slot's latest message.

Any process can be lost, also one without a machine's last will. As a will, the message is posted
on the slot, by a compare-and-swap in place of the latest one: it never replaces the message of
another process, one of several bridges posts it, and everybody sees it, not only ROS.
"""

from __future__ import annotations

import logging
from typing import Any, Generic

from llfsm.whiteboard import BoundSlot, Sample
from llfsm.whiteboard.errors import BoardClosedError, WhiteboardError
from llfsm.whiteboard.liveness import writer_lives
from llfsm.whiteboard.message import M

from ..timer_thread import TimerThread
from .link import BridgeLink, LinkFaults

__all__ = ["LossWatch"]

_LOG = logging.getLogger("llfsm.bridges.ros2")

_LOOK_S = 0.05  # between two looks, of which the second must find the same
_MEET_S = 1.0  # for the robot's nodes to find the bridge's: the message must not be too early


class LossWatch(Generic[M]):
    """Posts a message in place of the latest one of a process that has died, from now on.

    It does so also if that was before; not if the latest message is this one already. A machine's
    own last will is executed at once, and so before.
    """

    def __init__(
        self,
        slot: BoundSlot[M],
        message: M,
        data: bytes,
        link: BridgeLink,
        faults: LinkFaults,
        timer: TimerThread,
    ) -> None:
        """``data`` is the message as the slot encodes it."""
        self._slot = slot
        self._message = message
        self._data = data
        self._link = link
        self._faults = faults
        self._timer = timer
        self._lost = 0  # the count of a message whose process was dead at the last look
        self._is_over = False
        slot.reserve()  # so that it can be posted on a board that is full by then
        timer.call_later(_MEET_S, self._look)

    def finish(self) -> None:
        """Ask for the end."""
        self._is_over = True

    def close(self) -> None:
        """Do nothing: the next look is the end."""

    def _look(self) -> None:
        if self._is_over:
            return
        try:
            encoded = self._slot.encoded()
            if encoded is not None:
                self._judge(encoded[0] == self._data, Sample[Any](*encoded))
        except BoardClosedError:
            return
        except WhiteboardError as error:
            self._faults.count(self._link, error)
        self._timer.call_later(_LOOK_S, self._look)

    def _judge(self, is_posted: bool, latest: Sample[Any]) -> None:
        if is_posted or writer_lives(latest):
            self._lost = 0
        elif self._lost != latest.count:
            self._lost = latest.count
        elif self._slot.add_after(self._message, latest.count):
            _LOG.warning(
                "%s: process %d, which commanded it, has died; posted at_loss",
                self._link.slot,
                latest.writer,
            )
