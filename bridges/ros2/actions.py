"""An action's server on a transport: goals, feedback, cancelling, results.

An action is three services and two topics under ``<name>/_action/``. It answers and publishes what
rclcpp_action does, in the same order:

* ``send_goal``: a goal is executed immediately or refused. A known id is refused.
* ``cancel_goal``: by id; by time (all goals accepted until then); by both, either matches; by
  neither, all.
* ``get_result``: answered when the goal has ended; results are kept for 10 s.
* ``status``: all known goals, at each change, and kept for late subscriptions.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from llfsm.runtime.goals import GoalStatus
from llfsm.whiteboard import Message

from .call_queue import Put, through
from .errors import AlreadyAnsweredError
from .qos import DurabilityPolicy, Qos
from .stamps import from_ns, to_ns
from .transport import Node, ServiceRequest
from .types import RosAction, TypeLibrary

__all__ = ["STATUS_QOS", "ActionServer", "ServerGoal"]

_LOG = logging.getLogger("llfsm.bridges.ros2")

_KEPT_NS = 10_000_000_000  # rcl_action's default
STATUS_QOS = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=1)
"""Of the topic ``status``, at both ends (rcl_action_qos_profile_status_default)."""


class ServerGoal:
    """An accepted goal, for the code that executes it.

    message: the goal.
    status: EXECUTING; CANCELING once a request to cancel was accepted; or the final status.
    """

    def __init__(self, server: ActionServer, info: Any, message: Any) -> None:
        self.info = info
        self.message = message
        self.status = GoalStatus.EXECUTING
        self.ended_ns = 0
        self.response: Message | None = None
        self.waiting: list[ServiceRequest[Any, Any]] = []
        self._server = server
        self.request: ServiceRequest[Any, Any] | None = None  # while it is undecided

    def accept(self) -> None:
        """Accept it, if that was left open."""
        self._server.decide(self, True)

    def refuse(self) -> None:
        """Refuse it, if that was left open."""
        self._server.decide(self, False)

    def publish_feedback(self, feedback: Message) -> None:
        """Publish feedback."""
        self._server.publish_feedback(self, feedback)

    def end(self, status: GoalStatus, result: Message) -> None:
        """End as SUCCEEDED, CANCELED or ABORTED, and answer the callers that wait for the result.

        Raise :class:`.AlreadyAnsweredError` the second time.
        """
        if not self.status.active:
            raise AlreadyAnsweredError(f"this goal has ended already: {self.status.name}")
        self._server.end(self, status, result)


class ActionServer:
    """Serves one action of a node until it is closed.

    ``begin`` gets each new goal and returns whether it is accepted; with None that is left open,
    and decided by the goal's ``accept`` or ``refuse``. ``cancel`` gets a goal that a client wants
    to cancel and returns whether it agrees. Both may end goals, but ``cancel`` not the goal that it
    gets. They are called through ``put``, on the thread that owns the server: call no
    method on another.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        of: RosAction,
        types: TypeLibrary,
        *,
        begin: Callable[[ServerGoal], bool | None],
        cancel: Callable[[ServerGoal], bool],
        put: Put,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """``now_ns`` returns the node's time, by which results expire, too."""
        self._name = name
        self._begin = begin
        self._agree_to_cancel = cancel
        self._now_ns = now_ns
        self._goals: dict[bytes, ServerGoal] = {}
        self._undecided: dict[bytes, ServerGoal] = {}

        statuses = types.message("action_msgs/msg/GoalStatusArray")
        cancel_goal = types.service("action_msgs/srv/CancelGoal")
        self._info = types.message("action_msgs/msg/GoalInfo").message
        self._status = types.message("action_msgs/msg/GoalStatus").message
        self._statuses = statuses.message
        self._feedback = of.feedback_message.message
        self._accepted = of.send_goal.response.message
        self._cancelled: Any = cancel_goal.response.message
        self._result = of.get_result.response.message

        self._ends = ExitStack()
        opened = self._ends.enter_context
        self._send_feedback = opened(
            node.publisher(f"{name}/_action/feedback", of.feedback_message)
        ).publish
        self._send_statuses = opened(
            node.publisher(f"{name}/_action/status", statuses, STATUS_QOS)
        ).publish
        for service, of_service, take in (
            ("send_goal", of.send_goal, self._take_goal),
            ("cancel_goal", cancel_goal, self._take_cancel),
            ("get_result", of.get_result, self._take_result),
        ):
            opened(node.server(f"{name}/_action/{service}", of_service, through(put, take)))

    def close(self) -> None:
        """Take it off the graph; callers that wait for a result get none."""
        self._ends.close()

    def publish_feedback(self, goal: ServerGoal, feedback: Message) -> None:
        """Publish a goal's feedback."""
        self._send_feedback(self._feedback(goal_id=goal.info.goal_id, feedback=feedback))

    def end(self, goal: ServerGoal, status: GoalStatus, result: Message) -> None:
        """End a goal with a status and a result."""
        goal.status = status
        goal.ended_ns = self._now_ns()
        goal.response = self._result(status=int(status), result=result)
        for request in goal.waiting:
            request.answer(goal.response)
        goal.waiting.clear()
        self._publish_status()

    def _take_goal(self, request: ServiceRequest[Any, Any]) -> None:
        self._forget()
        message = request.message
        key = message.goal_id.uuid
        info = self._info(goal_id=message.goal_id, stamp=from_ns(self._now_ns()))
        goal = ServerGoal(self, info, message.goal)
        goal.request = request
        if key in self._goals or key in self._undecided:
            _LOG.warning("%s: refused a goal with a known id: %s", self._name, key.hex())
            accepted: bool | None = False
        else:
            accepted = self._accept(key, goal)
        if accepted is None:
            self._undecided[key] = goal
        else:
            self._answer(goal, accepted)

    def decide(self, goal: ServerGoal, accepted: bool) -> None:
        """Answer whether a goal is accepted, if that was left open."""
        key = goal.info.goal_id.uuid
        if self._undecided.pop(key, None) is goal:
            if accepted:
                self._goals[key] = goal
            self._answer(goal, accepted)

    def _answer(self, goal: ServerGoal, accepted: bool) -> None:
        request, goal.request = goal.request, None
        if request is not None:
            request.answer(self._accepted(accepted=accepted, stamp=goal.info.stamp))
        if accepted:
            self._publish_status()

    def _accept(self, key: bytes, goal: ServerGoal) -> bool | None:
        accepted: bool | None = False
        self._goals[key] = goal
        try:
            accepted = self._begin(goal)
        finally:
            if not accepted:
                del self._goals[key]
        return accepted

    def _take_cancel(self, request: ServiceRequest[Any, Any]) -> None:
        self._forget()
        wanted = request.message.goal_info
        code, meant = self._meant(wanted.goal_id.uuid, to_ns(wanted.stamp))
        agreed = [goal for goal in meant if self._agree_to_cancel(goal)]
        for goal in agreed:
            goal.status = GoalStatus.CANCELING
        if meant and not agreed:
            code = self._cancelled.ERROR_REJECTED
        if agreed:
            self._publish_status()
        infos = tuple(goal.info for goal in agreed)
        request.answer(self._cancelled(return_code=code, goals_canceling=infos))

    def _meant(self, key: bytes, until_ns: int) -> tuple[int, list[ServerGoal]]:
        """Return the code of the answer and the goals that a request would cancel."""
        if any(key) and not until_ns:
            goal = self._goals.get(key)
            if goal is None:
                return self._cancelled.ERROR_UNKNOWN_GOAL_ID, []
            if goal.status is not GoalStatus.EXECUTING:
                return self._cancelled.ERROR_GOAL_TERMINATED, []
            return self._cancelled.ERROR_NONE, [goal]
        everything = not until_ns
        return self._cancelled.ERROR_NONE, [
            goal
            for other, goal in self._goals.items()
            if goal.status is GoalStatus.EXECUTING
            and (everything or other == key or to_ns(goal.info.stamp) <= until_ns)
        ]

    def _take_result(self, request: ServiceRequest[Any, Any]) -> None:
        self._forget()
        goal = self._goals.get(request.message.goal_id.uuid)
        if goal is None:
            request.answer(self._result(status=int(GoalStatus.UNKNOWN)))
        elif goal.response is None:
            goal.waiting.append(request)
        else:
            request.answer(goal.response)

    def _forget(self) -> None:
        """Drop results older than 10 s."""
        then = self._now_ns() - _KEPT_NS
        self._goals = {
            key: goal
            for key, goal in self._goals.items()
            if goal.status.active or goal.ended_ns >= then
        }

    def _publish_status(self) -> None:
        statuses = (
            self._status(goal_info=goal.info, status=int(goal.status))
            for goal in self._goals.values()
        )
        self._send_statuses(self._statuses(status_list=tuple(statuses)))
