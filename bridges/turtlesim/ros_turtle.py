"""One turtle on a ROS graph: its topics, its services, its action."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import Any

from llfsm.runtime.goals import GoalStatus
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.turtlesim import Color, Pose

from ..ros2.actions import ActionServer, ServerGoal
from ..ros2.call_queue import Put, through
from ..ros2.node_time import NodeTime
from ..ros2.qos import Qos
from ..ros2.transport import Node, SerializedMessage, ServiceRequest
from ..ros2.types import TypeLibrary
from .rotate import RotateGoal
from .simulator import Simulator
from .turtle import Turtle

__all__ = ["RosTurtle"]

_QOS = Qos(depth=7)
_COMMAND_NS = 1_000_000_000


class RosTurtle:
    """Put a turtle on the graph, until it is closed.

    What comes in is done through ``put``, between two steps; what comes for a turtle that is gone
    by then is dropped, and its requests have failed.
    """

    def __init__(
        self,
        turtle: Turtle,
        simulator: Simulator,
        node: Node,
        types: TypeLibrary,
        put: Put,
        time: NodeTime,
    ) -> None:
        self.turtle = turtle
        self._simulator = simulator
        self._put_on = put
        self._time = time
        self._commanded_ns = time.now_ns()
        self._gone = False
        self._rotation: tuple[ServerGoal, RotateGoal] | None = None

        name = turtle.name
        rotate = types.action("turtlesim/action/RotateAbsolute")
        self._feedback = rotate.feedback.message
        self._result = rotate.result.message
        self._ends = ExitStack()
        opened = self._ends.enter_context
        self._publish_pose = opened(node.publisher(f"{name}/pose", types.of(Pose), _QOS)).publish
        self._publish_color = opened(
            node.publisher(f"{name}/color_sensor", types.of(Color), _QOS)
        ).publish
        opened(node.subscription(f"{name}/cmd_vel", types.of(Twist), self._on_command, _QOS))
        for service, type_name, do in (
            ("set_pen", "SetPen", self._set_pen),
            ("teleport_absolute", "TeleportAbsolute", self._teleport_absolute),
            ("teleport_relative", "TeleportRelative", self._teleport_relative),
        ):
            of = types.service(f"turtlesim/srv/{type_name}")
            answer = partial(_do_and_answer, do, of.response.message())
            opened(node.server(f"{name}/{service}", of, through(self._put, answer)))
        action = ActionServer(
            node,
            f"{name}/rotate_absolute",
            rotate,
            types,
            begin=self._begin,
            cancel=self._cancel,
            put=self._put,
            now_ns=time.now_ns,
        )
        self._ends.callback(action.close)

    def follow_time(self) -> None:
        """Let a command last for 1 s of a simulated time, which may stand still."""
        if self._time.simulated:
            elapsed_ns = self._time.now_ns() - self._commanded_ns
            self.turtle.let_command_last(lasts=elapsed_ns <= _COMMAND_NS)

    def publish(self) -> None:
        """Publish the turtle's pose and color and its goal's feedback after a step."""
        if self._rotation is not None:
            goal, rotation = self._rotation
            if rotation.status in (GoalStatus.EXECUTING, GoalStatus.SUCCEEDED):
                goal.publish_feedback(self._feedback(remaining=rotation.remaining))
        self._settle()
        self._publish_pose(Pose(*self.turtle.pose))
        self._publish_color(Color(*self.turtle.color))

    def close(self) -> None:
        """Take it off the graph; its goal, if any, has ended."""
        self._settle()
        self._gone = True
        self._ends.close()

    def _put(self, do: Callable[[], object]) -> None:
        self._put_on(lambda: None if self._gone else do())

    def _on_command(self, arrival: SerializedMessage[Twist]) -> None:
        self._put(
            partial(self._obey, arrival.decode())
        )  # here, so that the transport reports bad ones

    def _obey(self, twist: Twist) -> None:
        self._commanded_ns = self._time.now_ns()
        linear = twist.linear
        self._simulator.command(self.turtle.name, linear.x, linear.y, twist.angular.z)
        self._settle()  # a goal, which this has aborted

    def _set_pen(self, message: Any) -> None:
        self._simulator.set_pen(
            self.turtle.name, message.r, message.g, message.b, message.width, bool(message.off)
        )

    def _teleport_absolute(self, message: Any) -> None:
        self._simulator.teleport_absolute(self.turtle.name, message.x, message.y, message.theta)

    def _teleport_relative(self, message: Any) -> None:
        self._simulator.teleport_relative(self.turtle.name, message.linear, message.angular)

    def _begin(self, goal: ServerGoal) -> bool:
        rotation = self._simulator.rotate_absolute(self.turtle.name, goal.message.theta)
        if rotation is None:
            return False
        self._settle()  # the one before, which this one has aborted
        self._rotation = goal, rotation
        return True

    def _cancel(self, _: ServerGoal) -> bool:
        return self._rotation is not None and self._rotation[1].cancel()

    def _settle(self) -> None:
        """Send the goal's result if it has ended."""
        if self._rotation is not None and not self._rotation[1].active:
            goal, rotation = self._rotation
            self._rotation = None
            goal.end(rotation.status, self._result(delta=rotation.delta))


def _do_and_answer(
    do: Callable[[Any], None], answer: Any, request: ServiceRequest[Any, Any]
) -> None:
    do(request.message)
    request.answer(answer)
