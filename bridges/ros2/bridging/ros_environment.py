"""The environment of machines that are a ROS node themselves: no other process, no shared board."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from llfsm.bridges.ros2.bridging.bridge import Bridge
from llfsm.bridges.ros2.bridging.bridge_plan import BridgePlan
from llfsm.bridges.ros2.graph import Graph, Role
from llfsm.bridges.ros2.transport import Publisher, Transport
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Board, Whiteboard
from llfsm.whiteboard.closing import ClosedOnExit

if TYPE_CHECKING:
    from llfsm.runtime import Clock
    from llfsm.runtime.journal.handover import Handover


class RosEnvironment(ClosedOnExit, LiveEnvironment):
    """Sensors read topics and actuators publish on them, by a bridge in the machines' process.

    The bridge is the same as one in another process, but for the board: without one, the slots are
    in this process, and no other process sees the machines. A machine's turn never waits for the
    network: a post is a post to a slot, and a thread of the bridge publishes it. What is logged is
    published on /rosout.

    Close it after the arrangement has ended: then the safe values are published, too. It is a
    context manager.
    """

    def __init__(
        self,
        transport: Transport,
        plan: BridgePlan,
        *,
        board: Board | None = None,
        clock: Clock | None = None,
        handover: Handover | None = None,
        will_after_ms: int | None = None,
    ) -> None:
        """Put the node on the graph; the arguments are those of `LiveEnvironment`.

        Raise :class:`.SlotTypeError` for a slot that a ``board`` has with another type.
        """
        self._own = board is None
        if board is None:
            board = Whiteboard.local()
        super().__init__(board, clock, handover=handover, will_after_ms=will_after_ms)
        self.bridge = Bridge(plan, self.whiteboard, transport)
        self._transport = transport
        self._logs = plan.arguments.rosout
        if self._logs:
            logging.getLogger().addHandler(self.bridge.log)

    def wait_subscribed(self, timeout: float = 1.0) -> bool:
        """Wait until each topic that the machines publish has a subscription of another node.

        Return False after ``timeout`` seconds. What is posted before is lost for a node that has
        not found this one yet, as a command that is posted once.
        """
        ours = self.bridge.node.name
        topics = {link.name for link in self.bridge.links if isinstance(link.end, Publisher)}

        def subscribed(graph: Graph) -> bool:
            return all(
                any(end.node != ours for end in graph.ends(topic, Role.SUBSCRIPTION))
                for topic in topics
            )

        return self._transport.wait_graph(subscribed, timeout)

    def close(self) -> None:
        """Publish what was posted last, and take the node off the graph."""
        self.bridge.close()
        if self._logs:
            logging.getLogger().removeHandler(self.bridge.log)
        if self._own:
            self.whiteboard.close()
