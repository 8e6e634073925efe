"""Goals of an action in ROS go to a slot; a machine there accepts, reports on and ends them.

One goal at a time: while it is active, others are refused. All that happens is handled on one
thread, that of the bridge's timer.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from llfsm.runtime.goals import CancelGoal, GoalStanding, GoalStatus
from llfsm.whiteboard import BoundSlot, Sample

from ..actions import ActionServer, ServerGoal
from ..errors import CdrError
from .slot_action import ActionPlace, SlotAction

__all__ = ["SlotActionServer"]

_END_S = 1.0  # for the last goal's end


class _Served:
    def __init__(self, number: int, goal: ServerGoal) -> None:
        self.number = number
        self.goal = goal
        self.is_decided = False


class SlotActionServer(SlotAction):
    """Serves an action through slots, until it is closed.

    The machine accepts by a status with the goal's number, or refuses by REFUSED; without either
    within ``timeout`` seconds the goal is refused. A message with number 0 is for whichever goal
    there is. A goal that nobody waits for any more is canceled: one that was answered too late, the
    active one when the bridge ends, and that of a bridge that was lost.
    """

    def __init__(self, place: ActionPlace, now_ns: Callable[[], int]) -> None:
        """``now_ns`` returns the node's time."""
        super().__init__(place)
        board, slots = place.board, place.slots
        self._served: _Served | None = None
        self._goals: BoundSlot[Any] = board[slots.goal]
        self._cancels: BoundSlot[CancelGoal] = board[slots.cancel]
        standings, results = board[slots.status], board[slots.result]
        before = (self._goals.get(), standings.get(), results.get())
        self._number: int = max((message.number for message in before if message), default=0)
        if self._is_unfinished(*before):
            self._add(self._cancels, CancelGoal(self._number))
        for bound, take in (
            (standings, self._take_standing),
            (board[slots.feedback], self._take_feedback),
            (results, self._take_result),
        ):
            self._take_from(bound, take, bound.count)
        self._server = ActionServer(
            place.node,
            place.name,
            slots.of,
            place.types,
            begin=self._begin,
            cancel=self._cancel,
            put=self._timer.call_soon,
            now_ns=now_ns,
        )

    def close(self) -> None:
        """Abort the goal that there is, and wait for the end."""
        self._take_no_more()
        over = threading.Event()
        self._timer.call_soon(partial(self._give_up, "the bridge has ended"))
        self._timer.call_soon(over.set)
        over.wait(_END_S)
        self._server.close()

    @staticmethod
    def _is_unfinished(goal: Any, standing: GoalStanding | None, result: Any) -> bool:
        """Return whether the slots have a goal that a machine works on, or may begin."""
        refused = standing is not None and standing.status is GoalStatus.REFUSED
        ends = [each.number for each in (result, standing if refused else None) if each is not None]
        return goal is not None and goal.number > max(ends, default=0)

    # From ROS

    def _begin(self, goal: ServerGoal) -> bool | None:
        if self._served is not None:
            return False
        self._number += 1
        served = _Served(self._number, goal)
        if not self._add(self._goals, self._slots.asked(self._number, goal.message)):
            return False
        self._served = served
        self._timer.call_later(self._timeout, partial(self._too_late, served))
        return None

    def _too_late(self, served: _Served) -> None:
        if served is self._served and not served.is_decided:
            slot = self._slots.status.name
            self._give_up(f"no answer in slot {slot} within {self._timeout:g} s")

    def _cancel(self, goal: ServerGoal) -> bool:
        served = self._served
        if served is None or served.goal is not goal:
            return False
        return self._add(self._cancels, CancelGoal(served.number))

    # From the slots

    def _meant(self, number: int) -> _Served | None:
        served = self._served
        return served if served is not None and number in (0, served.number) else None

    def _take_standing(self, sample: Sample[GoalStanding]) -> None:
        standing, served = sample.message, self._meant(sample.message.number)
        if served is None or served.is_decided:
            return
        if standing.status is GoalStatus.REFUSED:
            self._abort(standing.failure)
        elif standing.status.active:
            self._accept(served)

    def _accept(self, served: _Served) -> None:
        served.is_decided = True
        served.goal.accept()

    def _take_feedback(self, sample: Sample[Any]) -> None:
        served = self._meant(sample.message.number)
        if served is not None and served.is_decided:
            served.goal.publish_feedback(self._slots.ros_feedback(sample.message))

    def _take_result(self, sample: Sample[Any]) -> None:
        served = self._meant(sample.message.number)
        if served is None:
            return
        status = sample.message.status
        if status is GoalStatus.REFUSED and not served.is_decided:
            self._abort(sample.message.failure)
            return
        if not served.is_decided:
            self._accept(served)
        canceling = served.goal.status is GoalStatus.CANCELING
        if not status.final or (status is GoalStatus.CANCELED and not canceling):
            text = f"a goal that is {served.goal.status.name} cannot end as {status.name}: aborted"
            self._faults.report(self._link, text, "status")
            status = GoalStatus.ABORTED
        result = self._slots.ros_result(sample.message)
        try:
            self._slots.of.result.encode(result)
        except CdrError as error:
            self._faults.count(self._link, error)
            status, result = GoalStatus.ABORTED, self._slots.of.result.message()
        self._served = None
        served.goal.end(status, result)
        self._link.count()

    def _give_up(self, why: str) -> None:
        """End the goal that there is, if there is one, for ROS and for the machine."""
        if self._served is not None:
            self._add(self._cancels, CancelGoal(self._served.number))
            self._abort(why)

    def _abort(self, why: str) -> None:
        """Refuse or abort the goal that there is; `why` is for the log, ROS has no place for it."""
        served, self._served = self._served, None
        if served is None:
            return
        self._link.failed += 1
        if why:
            self._faults.report(self._link, f"a goal was not carried out: {why}", "undone")
        if served.is_decided:
            served.goal.end(GoalStatus.ABORTED, self._slots.of.result.message())
        else:
            served.goal.refuse()
