"""Actions on a transport: their server, and their client.

An action is three services and two topics under ``<name>/_action/``. The server answers and
publishes what rclcpp_action does, in the same order:

* ``send_goal``: a goal is executed immediately or refused. A known id is refused.
* ``cancel_goal``: by id; by time (all goals accepted until then); by both, either matches; by
  neither, all.
* ``get_result``: answered when the goal has ended; results are kept for 10 s.
* ``status``: all known goals, at each change, and kept for late subscriptions.

A goal is one object with a status, EXECUTING, then perhaps CANCELING, then final. What is asked
about it before it has ended waits in it, so that no thread waits. All of a server happens on the
one thread that owns it, to which the requests are queued: goals need no locks.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

from llfsm.bridges.ros2.calls import through
from llfsm.bridges.ros2.errors import AlreadyAnsweredError
from llfsm.bridges.ros2.node_time import from_ns, to_ns
from llfsm.bridges.ros2.qos import TOPIC, DurabilityPolicy, Qos
from llfsm.bridges.ros2.threads import Put
from llfsm.bridges.ros2.transport import Node, SerializedMessage, ServiceRequest
from llfsm.bridges.ros2.types import RosAction, TypeLibrary
from llfsm.runtime.goals import GoalStatus
from llfsm.whiteboard import Message

_LOG = logging.getLogger("llfsm.bridges.ros2")

_KEPT_NS = 10_000_000_000  # rcl_action's default
_MOST_KEPT = 500  # results: each status message lists all goals
STATUS_QOS = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=1)
"""Of the topic ``status``, at both ends (rcl_action_qos_profile_status_default)."""


@dataclass(eq=False)
class ServerGoal:
    """A goal, for the code that executes it.

    message: the goal.
    status: EXECUTING; CANCELING once a request to cancel was accepted; or the final status.
    """

    server: ActionServer
    info: Any
    message: Any
    request: ServiceRequest[Any, Any] | None  # while it is undecided
    status: GoalStatus = GoalStatus.EXECUTING
    ended_ns: int = 0
    response: Message | None = None
    waiting: list[ServiceRequest[Any, Any]] = field(default_factory=list)

    def decide(self, accepted: bool) -> None:
        """Accept or refuse it, if that was left open."""
        self.server.decide(self, accepted)

    def publish_feedback(self, feedback: Message) -> None:
        """Publish feedback on this goal."""
        self.server.publish_feedback(self, feedback)

    def end(self, status: GoalStatus, result: Message) -> None:
        """End as SUCCEEDED, CANCELED or ABORTED, and answer the callers that wait for the result.

        Raise :class:`.AlreadyAnsweredError` the second time.
        """
        if not self.status.active:
            raise AlreadyAnsweredError(f"this goal has ended already: {self.status.name}")
        self.server.end(self, status, result)


@dataclass(eq=False)
class ActionServer:
    """Serves one action of a node until it is closed.

    ``begin`` gets each new goal and returns whether it is accepted; with None that is left open,
    and decided by the goal's ``decide``. ``cancel`` gets a goal that a client wants
    to cancel and returns whether it agrees. Both may end goals, but ``cancel`` not the goal that it
    gets. They are called through ``put``, on the thread that owns the server: call no
    method on another. ``now_ns`` returns the node's time, by which results expire, too.
    """

    node: Node
    name: str
    of: RosAction
    types: TypeLibrary
    _: KW_ONLY
    begin: Callable[[ServerGoal], bool | None]
    cancel: Callable[[ServerGoal], bool]
    put: Put
    now_ns: Callable[[], int] = time.time_ns

    def __post_init__(self) -> None:
        node, name, of, types = self.node, self.name, self.of, self.types
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
            opened(node.server(f"{name}/_action/{service}", of_service, through(self.put, take)))

    def close(self) -> None:
        """Take it off the graph; callers that wait for a result get none."""
        self._ends.close()

    def publish_feedback(self, goal: ServerGoal, feedback: Message) -> None:
        """Publish a goal's feedback."""
        self._send_feedback(self._feedback(goal_id=goal.info.goal_id, feedback=feedback))

    def end(self, goal: ServerGoal, status: GoalStatus, result: Message) -> None:
        """End a goal with a status and a result."""
        goal.status = status
        goal.ended_ns = self.now_ns()
        goal.response = self._result(status=int(status), result=result)
        for request in goal.waiting:
            request.answer(goal.response)
        goal.waiting.clear()
        self._publish_status()

    def _take_goal(self, request: ServiceRequest[Any, Any]) -> None:
        self._forget()
        message = request.message
        key = message.goal_id.uuid
        info = self._info(goal_id=message.goal_id, stamp=from_ns(self.now_ns()))
        goal = ServerGoal(self, info, message.goal, request)
        if key in self._goals or key in self._undecided:
            _LOG.warning("%s: refused a goal with a known id: %s", self.name, key.hex())
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
            accepted = self.begin(goal)
        finally:
            if not accepted:
                del self._goals[key]
        return accepted

    def _take_cancel(self, request: ServiceRequest[Any, Any]) -> None:
        self._forget()
        wanted = request.message.goal_info
        code, meant = self._meant(wanted.goal_id.uuid, to_ns(wanted.stamp))
        agreed = [goal for goal in meant if self.cancel(goal)]
        for goal in agreed:
            goal.status = GoalStatus.CANCELING
        if meant and not agreed:
            code = self._cancelled.ERROR_REJECTED
        if agreed:
            self._publish_status()
        infos = tuple(goal.info for goal in agreed)
        request.answer(self._cancelled(return_code=code, goals_canceling=infos))

    def _meant(self, key: bytes, until_ns: int) -> tuple[int, list[ServerGoal]]:
        """Choose the goals that a request would cancel, and the code of its answer."""
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
        """Drop results older than 10 s, and all but the latest 500."""
        then = self.now_ns() - _KEPT_NS
        ended = [key for key, goal in self._goals.items() if not goal.status.active]
        for place, key in enumerate(ended, _MOST_KEPT - len(ended)):
            if place < 0 or self._goals[key].ended_ns < then:
                del self._goals[key]

    def _publish_status(self) -> None:
        statuses = (
            self._status(goal_info=goal.info, status=int(goal.status))
            for goal in self._goals.values()
        )
        self._send_statuses(self._statuses(status_list=tuple(statuses)))


_RESULT_S = 30 * 86_400.0  # a goal may take as long as it likes: there is no call without a limit


@dataclass(eq=False)
class ActionClient:
    """Sends goals to an action's server, follows and cancels them, until it is closed.

    Goals have the 16 bytes of a UUID, which are the caller's choice. ``feedback`` gets each goal's
    feedback, ``status`` the status of each goal that the server reports, those of other clients
    included. Both are called on threads of the transport. The futures are those of a service's
    call; ``timeout`` is in seconds.
    """

    node: Node
    name: str
    of: RosAction
    types: TypeLibrary
    _: KW_ONLY
    feedback: Callable[[bytes, Message], None]
    status: Callable[[bytes, GoalStatus], None]

    def __post_init__(self) -> None:
        node, name, of, types = self.node, self.name, self.of, self.types
        cancel_goal = types.service("action_msgs/srv/CancelGoal")
        self._uuid = types.message("unique_identifier_msgs/msg/UUID").message
        self._info = types.message("action_msgs/msg/GoalInfo").message
        self._goal = of.send_goal.request.message
        self._cancel = cancel_goal.request.message
        self._result = of.get_result.request.message
        self._ends = ExitStack()
        opened = self._ends.enter_context
        self._goals = opened(node.client(f"{name}/_action/send_goal", of.send_goal))
        self._cancels = opened(node.client(f"{name}/_action/cancel_goal", cancel_goal))
        self._results = opened(node.client(f"{name}/_action/get_result", of.get_result))
        opened(
            node.subscription(
                f"{name}/_action/feedback", of.feedback_message, self._on_feedback, TOPIC
            )
        )
        statuses = types.message("action_msgs/msg/GoalStatusArray")
        opened(node.subscription(f"{name}/_action/status", statuses, self._on_statuses, STATUS_QOS))

    @property
    def ready(self) -> bool:
        """True if a server of all three services is known."""
        return self._goals.ready and self._cancels.ready and self._results.ready

    def send_goal(self, key: bytes, goal: Message, timeout: float) -> Future[Any]:
        """Send a goal; the response has ``accepted`` and ``stamp``. Raise :class:`.CdrError`."""
        request = self._goal(goal_id=self._uuid(uuid=key), goal=goal)
        return self._goals.call(request, timeout=timeout)

    def cancel_goal(self, key: bytes, timeout: float) -> Future[Any]:
        """Ask to cancel a goal; the response has ``return_code`` and ``goals_canceling``."""
        request = self._cancel(goal_info=self._info(goal_id=self._uuid(uuid=key)))
        return self._cancels.call(request, timeout=timeout)

    def get_result(self, key: bytes) -> Future[Any]:
        """Wait for a goal's end; the response has ``status`` and ``result``."""
        return self._results.call(self._result(goal_id=self._uuid(uuid=key)), timeout=_RESULT_S)

    def close(self) -> None:
        """Take it off the graph; its open calls end."""
        self._ends.close()

    def _on_feedback(self, arrival: SerializedMessage[Any]) -> None:
        message = arrival.decode()
        self.feedback(message.goal_id.uuid, message.feedback)

    def _on_statuses(self, arrival: SerializedMessage[Any]) -> None:
        for each in arrival.decode().status_list:
            self.status(each.goal_info.goal_id.uuid, GoalStatus(each.status))
