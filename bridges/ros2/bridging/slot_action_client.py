"""Goals in a slot are sent to an action's server; what becomes of them goes to other slots.

The newest goal counts: what becomes of those before it, which their server may have ended for it,
is not reported. All that happens is handled on one thread, that of the bridge's timer.
"""

from __future__ import annotations

from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Any
from uuid import uuid4

from llfsm.runtime.goals import CancelGoal, GoalStanding, GoalStatus
from llfsm.whiteboard import BoundSlot, Message, Sample

from ..action_client import ActionClient
from ..errors import CallTimeoutError, CdrError, Ros2Error, TransportClosedError
from .sender_will import SenderWill
from .slot_action import ActionPlace, SlotAction
from .slot_client import unanswered

__all__ = ["SlotActionClient"]

_LOOK_S = 0.1  # between two looks whether server and machine are still there
_END_S = 1.0  # for a cancellation at the bridge's end to be answered


class _Goal:
    def __init__(self, number: int, will: SenderWill | None = None) -> None:
        self.number = number
        self.will = will
        self.key = uuid4().bytes
        self.status = GoalStatus.UNKNOWN
        self.is_to_cancel = False  # asked before the server has answered
        self.is_over = False
        self.unserved_s = 0.0
        self.waited_s = 0.0  # since its result was asked for
        self.asks = 1


class SlotActionClient(SlotAction):
    """Sends the goals of a slot, and follows the newest.

    A goal from before the bridge started may or may not have been carried out: it is refused, so
    that nothing is done twice, and aborted if it was accepted. A goal that nobody can follow any
    more is canceled: one whose acceptance came too late, the active one when the bridge ends, and
    that of a machine whose last will, which was executed, cancels it.
    """

    def __init__(self, place: ActionPlace) -> None:
        super().__init__(place)
        board, slots = place.board, place.slots
        self._board = board
        self._goal: _Goal | None = None
        self._standings: BoundSlot[GoalStanding] = board[slots.status]
        self._feedback: BoundSlot[Any] = board[slots.feedback]
        self._results: BoundSlot[Any] = board[slots.result]
        goals: BoundSlot[Any] = board[slots.goal]
        cancels: BoundSlot[CancelGoal] = board[slots.cancel]
        self._seen = goals.count
        old = unanswered(goals, self._standings)
        if old is not None:
            self._refuse(_Goal(old), "it was posted before the bridge started")
        elif (left := self._standings.get()) is not None and left.status.active:
            self._end(_Goal(left.number), GoalStatus.ABORTED, "the bridge that sent it was lost")
        self._client = place.link.client = ActionClient(
            place.node,
            place.name,
            slots.of,
            place.types,
            feedback=self._on_thread(self._take_feedback),
            status=self._on_thread(self._take_status),
        )
        self._take_from(goals, self._send, self._seen)
        self._take_from(cancels, self._take_cancel, cancels.count)

    def close(self) -> None:
        """Cancel the active goal, and wait for the end."""
        self._take_no_more()
        cancelled: Future[Any] = Future()
        self._timer.call_soon(partial(self._end_all, cancelled))
        with suppress(Ros2Error, TimeoutError):
            cancelled.result(_END_S)
        self._client.close()

    # From the slots

    def _send(self, sample: Sample[Any]) -> None:
        lost, self._seen = sample.count - self._seen - 1, sample.count
        if lost:
            text = f"{lost} of the goals were replaced by newer ones before they were sent"
            self._faults.report(self._link, text, "lost")
        will = SenderWill(self._board, sample, self._slots.cancel.name)
        goal = self._goal = _Goal(sample.message.number, will)
        try:
            message = self._slots.ros_goal(sample.message)
            call = self._client.send_goal(goal.key, message, self._timeout)
        except (CdrError, TransportClosedError) as error:
            self._refuse(goal, str(error))
        else:
            call.add_done_callback(self._on_thread(partial(self._take_answer, goal)))

    def _take_cancel(self, sample: Sample[CancelGoal]) -> None:
        goal, number = self._goal, sample.message.number
        if goal is not None and not goal.is_over and number in (0, goal.number):
            self._cancel_wanted(goal)

    def _cancel_wanted(self, goal: _Goal) -> None:
        if goal.status.active:
            self._cancel(goal)
        else:
            goal.is_to_cancel = True

    def _cancel(self, goal: _Goal) -> Future[Any]:
        call = self._client.cancel_goal(goal.key, self._timeout)
        call.add_done_callback(self._on_thread(partial(self._take_cancelled, goal)))
        return call

    # From ROS

    def _take_answer(self, goal: _Goal, call: Future[Any]) -> None:
        error = call.exception()
        if error is not None:
            if isinstance(error, CallTimeoutError):  # and it may be accepted still
                self._cancel(goal)
            self._refuse(goal, str(error))
        elif not call.result().accepted:
            self._refuse(goal, "the server refused the goal")
        else:
            self._client.get_result(goal.key).add_done_callback(
                self._on_thread(partial(self._take_result, goal))
            )
            self._take_status(goal.key, GoalStatus.ACCEPTED)
            if goal.is_to_cancel:
                self._cancel(goal)
            self._watch_later(goal)

    def _take_status(self, key: bytes, status: GoalStatus) -> None:
        """Report progress; the end is reported with the result."""
        goal = self._goal
        if goal is None or goal.is_over or goal.key != key:
            return
        if goal.status < status < GoalStatus.SUCCEEDED:
            goal.status = status
            self._add(self._standings, GoalStanding(goal.number, status))

    def _take_feedback(self, key: bytes, feedback: Message) -> None:
        goal = self._goal
        if goal is not None and not goal.is_over and goal.key == key:
            self._add(self._feedback, self._slots.slot_feedback(goal.number, feedback))

    def _take_result(self, goal: _Goal, call: Future[Any]) -> None:
        error = call.exception()
        if error is not None:
            self._end(goal, GoalStatus.ABORTED, str(error))
            return
        response = call.result()
        status = GoalStatus(response.status)
        if status.final:
            self._end(goal, status, result=response.result)
        else:
            self._end(goal, GoalStatus.ABORTED, "the server does not know the goal any more")

    def _take_cancelled(self, goal: _Goal, call: Future[Any]) -> None:
        """Report a refusal; that it is agreed to is seen in the status."""
        error = call.exception()
        why = "" if error is None else str(error)
        if error is None and not call.result().goals_canceling:
            why = f"the server refused to cancel it (code {call.result().return_code})"
        if why and goal is self._goal and not goal.is_over:
            self._add(self._standings, GoalStanding(goal.number, goal.status, why))

    # The end of a goal

    def _refuse(self, goal: _Goal, why: str) -> None:
        self._end(goal, GoalStatus.REFUSED, why)

    def _end(
        self, goal: _Goal, status: GoalStatus, why: str = "", result: Message | None = None
    ) -> None:
        if goal.is_over:
            return
        goal.is_over, goal.status = True, status
        if why:
            self._link.failed += 1
        else:
            self._link.count()
        if goal is not self._goal and self._goal is not None:
            return  # there is a newer one
        self._add(
            self._results,
            self._slots.failed(goal.number, status, why)
            if result is None
            else self._slots.ended(goal.number, status, result),
        )
        self._add(self._standings, GoalStanding(goal.number, status, why))

    def _watch_later(self, goal: _Goal) -> None:
        self._timer.call_later(_LOOK_S, partial(self._watch, goal))

    def _watch(self, goal: _Goal) -> None:
        """End a goal whose server has gone: not every middleware ends the call for its result.

        A server that was started again is asked for the result, and answers that it does not know
        the goal. As not every middleware notices that the first one was killed, the server is asked
        again in any case, ever more rarely. Cancel a goal whose machine has gone.
        """
        if goal.is_over or goal is not self._goal:
            return
        if goal.will is not None and goal.will.is_executed:
            goal.will = None
            self._faults.report(self._link, f"goal {goal.number}: its machine is lost", "lost")
            self._cancel_wanted(goal)
        goal.waited_s += _LOOK_S
        ready = self._client.ready
        if ready and (goal.unserved_s or goal.waited_s > self._timeout * goal.asks):
            self._ask_again(goal)
        goal.unserved_s = 0.0 if ready else goal.unserved_s + _LOOK_S
        if goal.unserved_s > self._timeout:
            self._end(goal, GoalStatus.ABORTED, "the server has gone")
        else:
            self._watch_later(goal)

    def _ask_again(self, goal: _Goal) -> None:
        goal.waited_s, goal.asks = 0.0, goal.asks * 2

        def take(call: Future[Any]) -> None:
            if call.exception() is None:
                self._take_result(goal, call)

        self._client.get_result(goal.key).add_done_callback(self._on_thread(take))

    def _end_all(self, cancelled: Future[Any]) -> None:
        goal = self._goal
        try:
            if goal is not None and goal.status.active:
                call = self._cancel(goal)
                call.add_done_callback(lambda _: cancelled.set_result(None))
                self._end(goal, GoalStatus.ABORTED, "the bridge has ended")
                return
        except TransportClosedError:
            pass
        cancelled.set_result(None)
