"""Both ends of an action: Navigation2's and a machine's part, and a client's in ROS."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from uuid import uuid4

from llfsm.bridges.ros2.actions import ActionClient, ActionServer
from llfsm.bridges.ros2.bridging import action_slots
from llfsm.bridges.ros2.threads import CallQueue
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.runtime.goals import GoalStatus
from waiting import PATIENCE_S, wait_for

EXAMPLE = Path(__file__).parents[4] / "examples" / "nav2_patrol"
TYPES = TypeLibrary(share=[EXAMPLE / "nav2_msgs"])
OF = TYPES.action("nav2_msgs/action/NavigateToPose")
SLOTS = action_slots("navigate", OF)
GOAL, FEEDBACK, RESULT = SLOTS.goal.type, SLOTS.feedback.type, SLOTS.result.type


class Navigator:
    """Navigation2's part: goals that a test begins and ends by hand."""

    def __init__(self, transport):
        self.queue, self.begun, self.cancels = CallQueue(), [], True
        self.accepts = True
        self.server = ActionServer(
            transport.node("bt_navigator"),
            "navigate_to_pose",
            OF,
            TYPES,
            begin=self._begin,
            cancel=lambda _: self.cancels,
            put=self.queue.put,
        )

    def _begin(self, goal):
        self.begun.append(goal)
        return self.accepts

    def until(self, ready):
        wait_for(ready, between=self.queue.run_pending)


class Client:
    """A machine's part: what is on the board for the goal that it sent."""

    def __init__(self, board, bridge, navigator):
        self.board = board
        self.bridge = bridge
        self.number = 0
        self.seen = []
        self.standings = board[SLOTS.status]
        navigator.until(lambda: bridge.links[0].client.ready)
        self.navigator = navigator

    def send(self, **fields):
        self.number += 1
        self.board.add_message(SLOTS.goal, GOAL(self.number, **fields))

    def stands(self, status, number=None):
        number = self.number if number is None else number

        def stood():
            found = self.standings.get()
            return found is not None and (found.number, found.status) == (number, status)

        self.navigator.until(stood)
        return self.standings.get()

    def drives(self):
        """Send a goal that is accepted, and return the server's end of it."""
        self.send(behavior_tree="tree")
        self.navigator.until(lambda: len(self.navigator.begun) == self.number)
        self.stands(GoalStatus.EXECUTING)
        return self.navigator.begun[-1]


class Caller:
    """ROS's part: a client of the action that a machine serves."""

    def __init__(self, transport):
        self.feedback, self.statuses, self.bridge = [], [], None
        self.key = uuid4().bytes
        self._client = ActionClient(
            transport.node("caller"),
            "navigate_to_pose",
            OF,
            TYPES,
            feedback=lambda key, message: self.feedback.append((key, message)),
            status=lambda key, status: self.statuses.append((key, status)),
        )
        self._transport = transport

    def send(self, **fields):
        assert self._transport.wait_graph(lambda _: self._client.ready, PATIENCE_S)
        return self._client.send_goal(self.key, OF.goal.message(**fields), PATIENCE_S)

    def __getattr__(self, name):
        return partial(getattr(self._client, name), self.key)
