"""The simulator as a ROS 2 node, on any transport: turtlesim's whole graph.

A :class:`RosTurtle` has the topics, services and action of one turtle; the node adds and removes
them as turtles come and go. All that arrives waits in a queue for the next step.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from itertools import count
from typing import Any

from llfsm.bridges.ros2.actions import ActionServer, ServerGoal
from llfsm.bridges.ros2.calls import answering, through
from llfsm.bridges.ros2.node_time import CLOCK, CLOCK_QOS, CLOCK_TYPE, NodeTime, from_ns
from llfsm.bridges.ros2.parameter_server import PARAMETER_EVENTS, PARAMETER_QOS
from llfsm.bridges.ros2.qos import Qos, ReliabilityPolicy
from llfsm.bridges.ros2.ros_arguments import RosArguments
from llfsm.bridges.ros2.standard_node import equip
from llfsm.bridges.ros2.threads import CallQueue, Put
from llfsm.bridges.ros2.transport import Node, SerializedMessage, Transport
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.turtlesim.parameters import Parameters
from llfsm.bridges.turtlesim.simulator import STEP_NS, Simulator
from llfsm.bridges.turtlesim.turtle import Level, Log, RotateGoal, Turtle
from llfsm.runtime.goals import GoalStatus
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.turtlesim import Color, Pose

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
            opened(node.server(f"{name}/{service}", of, through(self._put, answering(of, do))))
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
        twist = arrival.decode()  # here, so that the transport reports bad ones
        self._put(partial(self._obey, twist))

    def _obey(self, twist: Twist) -> None:
        self._commanded_ns = self._time.now_ns()
        linear = twist.linear
        self._simulator.command(self.turtle.name, linear.x, linear.y, twist.angular.z)
        self._settle()  # a goal, which this has aborted

    def _set_pen(self, asked: Any) -> dict[str, str]:
        rgb = asked.r, asked.g, asked.b
        self._simulator.set_pen(self.turtle.name, *rgb, asked.width, bool(asked.off))
        return {}

    def _teleport_absolute(self, asked: Any) -> dict[str, str]:
        self._simulator.teleport_absolute(self.turtle.name, asked.x, asked.y, asked.theta)
        return {}

    def _teleport_relative(self, asked: Any) -> dict[str, str]:
        self._simulator.teleport_relative(self.turtle.name, asked.linear, asked.angular)
        return {}

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


_NEVER = 100  # above every level


class RosTurtlesim:
    """The node ``turtlesim`` on a transport.

    Messages and requests wait in a queue for the next step, as in turtlesim, which handles ROS
    callbacks before each step. So the simulator runs on one thread, which also answers requests.

    simulator: the simulator; between two steps it may be used freely.
    queue: the calls that wait for the next step.
    time: the node's, which is simulated by ``use_sim_time``.
    log: called with each line of the log, which is published on /rosout, too.
    """

    def __init__(
        self,
        transport: Transport,
        log: Log,
        arguments: RosArguments = RosArguments(),  # noqa: B008 (immutable)
        *,
        clock: bool = False,
    ) -> None:
        """Put the node on the graph; raise :class:`.RosArgumentError`.

        ``clock``: publish the simulated time on /clock, 16 ms at the first step.
        """
        self.queue = CallQueue()
        self._types = types = TypeLibrary()
        names = arguments.names("turtlesim")
        self._node = node = transport.node(names.node, names.namespace, names.remap)
        parameters = Parameters()
        parameters.override(arguments.parameters(names.full_node))
        self._rosout, self.time = equip(node, types, parameters, self.queue.put)
        level = arguments.log_level(names.full_node)
        self._rosout.setLevel(level if arguments.rosout else _NEVER)
        self._log = log
        self.simulator = Simulator(self._log_line, parameters)
        self._turtles: dict[str, RosTurtle] = {}
        # The real node paints anew on such an event, and its clock looks for a simulated time.
        # Here nothing follows from it, but tools show the same graph.
        event = types.message("rcl_interfaces/msg/ParameterEvent")
        for qos in (PARAMETER_QOS, Qos(ReliabilityPolicy.BEST_EFFORT, depth=100)):
            node.subscription(PARAMETER_EVENTS, event, lambda _: None, qos)
        self._clock = self._clock_publisher() if clock else None
        self._serve("clear", "std_srvs/srv/Empty", self._clear)
        self._serve("reset", "std_srvs/srv/Empty", self._reset)
        self._serve("spawn", "turtlesim/srv/Spawn", self._spawn)
        self._serve("kill", "turtlesim/srv/Kill", self._kill)
        self._follow_turtles()

    def step(self) -> None:
        """Handle pending messages, advance by 16 ms of simulated time, publish the results."""
        self.queue.run_pending()
        for turtle in self._turtles.values():
            turtle.follow_time()
        self.simulator.step()
        if self._clock is not None:
            self._clock()
        for turtle in self._turtles.values():
            turtle.publish()

    def spawn(self, x: float, y: float, theta: float, name: str = "") -> str:
        """Make a turtle as `Simulator.spawn` does, and put it on the graph."""
        name = self.simulator.spawn(x, y, theta, name)
        self._follow_turtles()
        return name

    def _clock_publisher(self) -> Callable[[], None]:
        of = self._types.message(CLOCK_TYPE)
        publish = self._node.publisher(CLOCK, of, CLOCK_QOS).publish
        steps = count(1)
        return lambda: publish(of.message(clock=from_ns(next(steps) * STEP_NS)))

    def _serve(self, name: str, type_name: str, do: Callable[[Any], dict[str, str]]) -> None:
        of = self._types.service(type_name)
        self._node.server(name, of, through(self.queue.put, answering(of, do)))

    def _clear(self, _: Any) -> dict[str, str]:
        self.simulator.clear()
        return {}

    def _reset(self, _: Any) -> dict[str, str]:
        self.simulator.reset()
        self._follow_turtles()
        return {}

    def _spawn(self, asked: Any) -> dict[str, str]:
        return {"name": self.spawn(asked.x, asked.y, asked.theta, asked.name)}

    def _kill(self, asked: Any) -> dict[str, str]:
        self.simulator.kill(asked.name)
        self._follow_turtles()
        return {}

    def _follow_turtles(self) -> None:
        """Add new turtles to the graph and remove killed ones. A reset makes a new turtle1."""
        turtles = self.simulator.turtles
        for name, on_graph in list(self._turtles.items()):
            if turtles.get(name) is not on_graph.turtle:
                del self._turtles[name]
                on_graph.close()
        for name, turtle in turtles.items():
            if name not in self._turtles:
                self._turtles[name] = RosTurtle(
                    turtle, self.simulator, self._node, self._types, self.queue.put, self.time
                )

    def _log_line(self, level: Level, text: str) -> None:
        self._log(level, text)
        origin = inspect.currentframe()
        if origin is not None and (origin := origin.f_back) is not None:
            code = origin.f_code
            self._rosout.log(level, text, code.co_filename, code.co_name, origin.f_lineno)
