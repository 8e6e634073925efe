"""An action through slots: goals in a slot are sent to a server, or goals from ROS go to a slot.

Requests, slots, timers and calls happen on threads of their own. All of them are handed to one
thread, that of the bridge's timer, so the state of a goal needs no lock, and what happens to it has
an order.

* **One goal counts.** A client follows the newest; what becomes of those before it, which their
  server may have ended for it, is not reported. A server has one, and refuses others meanwhile.
* **No goal is left alone.** One that nobody can follow any more is canceled: its bridge ends, its
  answer came too late, its machine is lost. A guard posts a safe value only in place of a message
  of the process that has died. On the slot for cancellations a machine has posted none while it
  waits for its goal, so the bridge looks itself whether its last will, which cancels goals, has
  been executed (:class:`SenderWill`).
* **No wait is endless.** Not every middleware ends the calls to a server that was killed, so a
  client looks for it, and asks again for the result.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple
from uuid import uuid4

from llfsm.bridges.ros2.actions import ActionClient, ActionServer, ServerGoal
from llfsm.bridges.ros2.bridging._slot_service import unanswered
from llfsm.bridges.ros2.bridging.link import BridgeLink
from llfsm.bridges.ros2.bridging.service_slots import ActionSlots, from_slot, into_slot
from llfsm.bridges.ros2.errors import CallTimeoutError, CdrError, Ros2Error, TransportClosedError
from llfsm.bridges.ros2.threads import TimerThread
from llfsm.bridges.ros2.transport import Node
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.runtime.goals import CancelGoal, GoalStanding, GoalStatus
from llfsm.whiteboard import Board, BoundSlot, Message, Sample
from llfsm.whiteboard.errors import (
    BoardClosedError,
    MessageUnreadableError,
    SlotError,
    WhiteboardError,
)
from llfsm.whiteboard.liveness import writer_lives
from llfsm.whiteboard.messages.llfsm import WILLS, LastWill, will_slot


class ActionPlace(NamedTuple):
    """The parts that an end of an action connects."""

    board: Board
    slots: ActionSlots
    node: Node
    name: str
    """The action's name, as the node resolves it."""
    types: TypeLibrary
    timeout: float
    """Seconds that an answer may take, and a server be away."""
    link: BridgeLink
    timer: TimerThread
    """Whose thread it is."""


class SlotAction:
    """An end of an action whose goals are in slots, with all that both ends share."""

    def __init__(self, place: ActionPlace) -> None:
        self._slots = place.slots
        self._timeout = place.timeout
        self._link = place.link
        self._timer = place.timer
        self._subscriptions: list[Any] = []

    def finish(self) -> None:
        """Stop after the messages that are on the slots by now."""
        for subscription in self._subscriptions:
            subscription.finish()

    def _take_from(self, slot: BoundSlot[Any], take: Callable[..., None], after: int) -> None:
        """Call `take` with each message that comes on the slot."""
        self._subscriptions.append(
            slot.subscribe(self._on_thread(take), after=after, on_error=self._link.count_fault)
        )

    def _take_no_more(self) -> None:
        for subscription in self._subscriptions:
            subscription.close()

    def _on_thread(self, do: Callable[..., None]) -> Callable[..., None]:
        def guarded(*arguments: Any) -> None:
            with suppress(BoardClosedError, TransportClosedError):  # the bridge ends
                try:
                    do(*arguments)
                except CdrError as error:  # a value that ROS cannot have
                    self._link.count_fault(error)

        return lambda *arguments: self._timer.call_soon(partial(guarded, *arguments))

    def _add(self, slot: BoundSlot[Any], message: Message) -> bool:
        try:
            slot.add(message)
        except BoardClosedError:
            return False  # the bridge ends
        except WhiteboardError as error:
            self._link.count_fault(error)
            return False
        return True


class SenderWill:
    """The last will of the process that has posted a goal, as far as it cancels goals."""

    def __init__(self, board: Board, goal: Sample[Any], cancels: str) -> None:
        """``cancels`` is the name of the slot for cancellations."""
        self._goal = goal
        self._wills: list[BoundSlot[LastWill]] = []
        for info in board.slots():
            if not info.name.startswith(WILLS):
                continue
            with suppress(SlotError, MessageUnreadableError):  # not a will, whatever its name
                will = board.present(will_slot(info.name.removeprefix(WILLS)))
                sample = will.sample()
                if sample is None or sample.writer != goal.writer:
                    continue
                if any(value.slot == cancels for value in sample.message.values):
                    self._wills.append(will)

    @property
    def is_executed(self) -> bool:
        """True if the process has died, or was silent for so long that it counts as dead."""
        return any(self._is_executed(will) for will in self._wills)

    def _is_executed(self, will: BoundSlot[LastWill]) -> bool:
        sample = None
        with suppress(MessageUnreadableError, BoardClosedError):  # or the bridge ends
            sample = will.sample()
        if sample is None:  # withdrawn, and its name given up
            return False
        if sample.message.state == "left" and sample.writer != self._goal.writer:
            return not writer_lives(self._goal)  # a machine has replaced the one that is lost
        return sample.message.state == "executed"


_LOOK_S = 0.1  # between two looks whether server and machine are still there
_CANCEL_S = 1.0  # for a cancellation at the bridge's end to be answered


@dataclass(eq=False)
class _Goal:
    number: int
    will: SenderWill | None = None
    posted_ns: int = 0
    key: bytes = field(default_factory=lambda: uuid4().bytes)
    status: GoalStatus = GoalStatus.UNKNOWN
    is_to_cancel: bool = False  # asked before the server has answered
    is_over: bool = False
    unserved_s: float = 0.0
    waited_s: float = 0.0  # since its result was asked for
    asks: int = 1


class SlotActionClient(SlotAction):
    """Sends the goals of a slot, and follows the newest.

    A goal from before the bridge started may or may not have been carried out: it is refused, so
    that nothing is done twice, and aborted if it was accepted.
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
        """Cancel the active goal, and wait up to a second for the answer."""
        self._take_no_more()
        cancelled: Future[Any] = Future()
        self._timer.call_soon(partial(self._end_all, cancelled))
        with suppress(Ros2Error, TimeoutError):
            cancelled.result(_CANCEL_S)
        self._client.close()

    # From the slots

    def _send(self, sample: Sample[Any]) -> None:
        lost, self._seen = sample.count - self._seen - 1, sample.count
        if lost:
            text = f"{lost} of the goals were replaced by newer ones before they were sent"
            self._link.report_fault(text, "lost")
        will = SenderWill(self._board, sample, self._slots.cancel.name)
        goal = self._goal = _Goal(sample.message.number, will, sample.stamp_ns)
        try:
            message = from_slot(self._slots.of.goal, sample.message)
            call = self._client.send_goal(goal.key, message, self._timeout)
        except (CdrError, TransportClosedError) as error:
            self._refuse(goal, str(error))
        else:
            call.add_done_callback(self._on_thread(partial(self._take_answer, goal)))

    def _take_cancel(self, sample: Sample[CancelGoal]) -> None:
        goal, number = self._goal, sample.message.number
        if goal is None or goal.is_over:
            return
        # Slots have no order among each other: one for any goal is not for those posted after it.
        if number == goal.number or (number == 0 and sample.stamp_ns >= goal.posted_ns):
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
            self._add(self._feedback, into_slot(self._slots.feedback, goal.number, feedback))

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
            else into_slot(self._slots.result, goal.number, result, status),
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
            self._link.report_fault(f"goal {goal.number}: its machine is lost", "lost")
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


_END_S = 1.0  # for the last goal's end


@dataclass(eq=False)
class _Served:
    number: int
    goal: ServerGoal
    is_decided: bool = False


class SlotActionServer(SlotAction):
    """Serves an action through slots, until it is closed.

    The machine accepts by a status with the goal's number, or refuses by REFUSED; without either
    within ``timeout`` seconds the goal is refused. A message with number 0 is for whichever goal
    there is.
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
        """Abort the goal that there is, and wait up to a second until it has ended."""
        self._take_no_more()
        over = threading.Event()
        self._timer.call_soon(partial(self._give_up, "the bridge has ended"))
        self._timer.call_soon(over.set)
        over.wait(_END_S)
        self._server.close()

    @staticmethod
    def _is_unfinished(goal: Any, standing: GoalStanding | None, result: Any) -> bool:
        """Check if the slots have a goal that a machine works on, or may begin."""
        refused = standing is not None and standing.status is GoalStatus.REFUSED
        ends = [each.number for each in (result, standing if refused else None) if each is not None]
        return goal is not None and goal.number > max(ends, default=0)

    # From ROS

    def _begin(self, goal: ServerGoal) -> bool | None:
        if self._served is not None:
            return False
        self._number += 1
        served = _Served(self._number, goal)
        if not self._add(self._goals, into_slot(self._slots.goal, self._number, goal.message)):
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
        served.goal.decide(True)

    def _take_feedback(self, sample: Sample[Any]) -> None:
        served = self._meant(sample.message.number)
        if served is not None and served.is_decided:
            served.goal.publish_feedback(from_slot(self._slots.of.feedback, sample.message))

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
            self._link.report_fault(text, "status")
            status = GoalStatus.ABORTED
        result = from_slot(self._slots.of.result, sample.message)
        try:
            self._slots.of.result.encode(result)
        except CdrError as error:
            self._link.count_fault(error)
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
            self._link.report_fault(f"a goal was not carried out: {why}", "undone")
        if served.is_decided:
            served.goal.end(GoalStatus.ABORTED, self._slots.of.result.message())
        else:
            served.goal.decide(False)
