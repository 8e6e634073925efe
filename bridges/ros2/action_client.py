"""An action's client on a transport: sends goals, follows and cancels them, gets their results."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from typing import Any

from llfsm.runtime.goals import GoalStatus
from llfsm.whiteboard import Message

from .actions import STATUS_QOS
from .qos import TOPIC
from .transport import Node, SerializedMessage
from .types import RosAction, TypeLibrary

__all__ = ["ActionClient"]

_RESULT_S = 30 * 86_400.0  # a goal may take as long as it likes: there is no call without a limit


class ActionClient:
    """Knows an action's server of any node until it is closed.

    Goals have the 16 bytes of a UUID, which are the caller's choice. ``feedback`` gets each goal's
    feedback, ``status`` the status of each goal that the server reports, those of other clients
    included. Both are called on threads of the transport. The futures are as of a service's call.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        of: RosAction,
        types: TypeLibrary,
        *,
        feedback: Callable[[bytes, Message], None],
        status: Callable[[bytes, GoalStatus], None],
    ) -> None:
        cancel_goal = types.service("action_msgs/srv/CancelGoal")
        self._uuid = types.message("unique_identifier_msgs/msg/UUID").message
        self._info = types.message("action_msgs/msg/GoalInfo").message
        self._goal = of.send_goal.request.message
        self._cancel = cancel_goal.request.message
        self._result = of.get_result.request.message
        self._of_feedback = feedback
        self._of_status = status
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
        """Whether a server of all three services is known."""
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
        self._of_feedback(message.goal_id.uuid, message.feedback)

    def _on_statuses(self, arrival: SerializedMessage[Any]) -> None:
        for each in arrival.decode().status_list:
            self._of_status(each.goal_info.goal_id.uuid, GoalStatus(each.status))
