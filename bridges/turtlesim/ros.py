"""The simulator as a ROS 2 node, on any transport: turtlesim's whole graph."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from itertools import count
from typing import Any

from ..ros2.call_queue import CallQueue, through
from ..ros2.node_time import CLOCK, CLOCK_QOS, CLOCK_TYPE
from ..ros2.parameter_server import PARAMETER_EVENTS, PARAMETER_QOS
from ..ros2.qos import Qos, ReliabilityPolicy
from ..ros2.ros_arguments import RosArguments
from ..ros2.stamps import from_ns
from ..ros2.standard_node import equip
from ..ros2.transport import ServiceRequest, Transport
from ..ros2.types import TypeLibrary
from .parameters import Parameters
from .ros_turtle import RosTurtle
from .simulator import STEP_NS, Simulator
from .turtle import Level, Log

__all__ = ["RosTurtlesim"]

_NEVER = 100  # above every level


class RosTurtlesim:
    """The node ``turtlesim`` on a transport.

    Messages and requests wait in a queue for the next step, as in turtlesim, which handles ROS
    callbacks before each step. So the simulator runs on one thread, which also answers requests.

    simulator: the simulator; between two steps it may be used freely.
    queue: what waits for the next step.
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
        """Have requests of a service answered with the fields that ``do`` returns."""
        of = self._types.service(type_name)

        def answer(request: ServiceRequest[Any, Any]) -> None:
            request.answer(of.response.message(**do(request.message)))

        self._node.server(name, of, through(self.queue.put, answer))

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
                    turtle,
                    self.simulator,
                    self._node,
                    self._types,
                    self.queue.put,
                    self.time,
                )

    def _log_line(self, level: Level, text: str) -> None:
        self._log(level, text)
        origin = inspect.currentframe()
        if origin is not None and (origin := origin.f_back) is not None:
            code = origin.f_code
            self._rosout.log(level, text, code.co_filename, code.co_name, origin.f_lineno)
