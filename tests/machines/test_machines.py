"""The shipped machines do what their tables say, step by step, under a manual clock."""

from __future__ import annotations

import math

import pytest

from llfsm.machines import (
    RosBlindTurttleBot,
    RosPingPong,
    RosWallTurttleBot,
    TurtleSuspendResume,
)
from llfsm.machines.common import CMD_VEL
from llfsm.machines.ping_pong import PINPONG
from llfsm.runtime import Arrangement, Machine, ManualClock
from llfsm.runtime.engine.events import Event, Section
from llfsm.whiteboard import Board, Message, Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.turtle_sensor_poster import ANSWER, REQUEST, TurtlePositionAnswer

TABLES = {
    RosPingPong: {
        "INITIAL": [("after_ms(1000)", "PUBLISH")],
        "PUBLISH": [("after_ms(10)", "WAIT_AND_COUNT")],
        "WAIT_AND_COUNT": [("after_ms(10)", "PUBLISH")],
    },
    RosBlindTurttleBot: {
        "INITIAL": [("after_ms(1000)", "STRAIGHT")],
        "STRAIGHT": [("after_ms(1000)", "TURN_RIGHT")],
        "TURN_RIGHT": [("after_ms(1000)", "STRAIGHT")],
    },
    RosWallTurttleBot: {
        "INITIAL": [("after_ms(1000)", "STRAIGHT")],
        "STRAIGHT": [("after_ms(1000)", "STOP")],
        "STOP": [("after_ms(1000) and answered", "TEST")],
        "TEST": [("away_from_walls", "STRAIGHT"), ("after_ms(1000)", "BACK")],
        "BACK": [("after_ms(1000)", "TURN_RIGHT")],
        "TURN_RIGHT": [("after_ms(1000)", "STRAIGHT")],
    },
    TurtleSuspendResume: {
        "INITIAL": [("target_is_suspended", "HOLD")],
        "HOLD": [("after_ms(3000)", "RESTART")],
        "RESTART": [("target_is_running", "WATCH")],
        "WATCH": [("after_ms(5000)", "INITIAL")],
    },
}


@pytest.mark.parametrize("machine", TABLES, ids=lambda machine: machine.__name__)
def test_table(machine: type[Machine]) -> None:
    states = {
        state.name: [(t.label, t.target.name) for t in state.transitions]
        for state in machine.table.states
    }
    ending = [("stopping", "END")]
    assert states == {name: row + ending for name, row in TABLES[machine].items()} | {"END": []}


class Run:
    """An arrangement on a local board that notes what is entered and posted, and when."""

    def __init__(self, *machines: type[Machine]) -> None:
        self.clock = ManualClock()
        self.board: Board = Whiteboard.local()
        self.entered: list[tuple[int, str]] = []
        self.arrangement = Arrangement(
            machines, whiteboard=self.board, clock=self.clock, observers=[self.note]
        )

    def note(self, event: Event) -> None:
        if isinstance(event, Section) and event.section == "OnEntry":
            self.entered.append((event.time_ns // 1_000_000, event.state))

    def until(self, ms: int) -> None:
        """Run with a round every millisecond."""
        while self.clock.now_ns() < ms * 1_000_000:
            self.arrangement.round()
            self.clock.advance(ms=1)

    def latest(self, slot: Slot[Message]) -> Message | None:
        return self.board.get_message(slot)


def test_ping_pong_counts() -> None:
    run = Run(RosPingPong)
    posted = []
    while len(posted) < 4:
        run.arrangement.round()
        message = run.board.get_message(PINPONG)
        if message is not None and (not posted or posted[-1] is not message):
            posted.append(message)
        run.clock.advance(ms=1)
    assert [message.data for message in posted] == [f"hello world {n}" for n in range(4)]
    assert run.entered[:4] == [
        (0, "INITIAL"),
        (1002, "PUBLISH"),
        (1014, "WAIT_AND_COUNT"),
        (1026, "PUBLISH"),
    ]


def test_blind_turtle_alternates() -> None:
    run = Run(RosBlindTurttleBot)
    run.until(500)
    assert run.board[CMD_VEL].count == 0  # INITIAL posts nothing
    run.until(1500)
    assert run.board.get_message(CMD_VEL).linear.x == 2.0
    run.until(2500)
    twist = run.board.get_message(CMD_VEL)
    assert (twist.linear.x, twist.angular.z) == (0.0, -2.0)
    run.until(3500)
    assert run.board.get_message(CMD_VEL).linear.x == 2.0


def answer(run: Run, x: float, y: float, failure: str = "") -> None:
    request = run.board.get_message(REQUEST)
    run.board.add_message(ANSWER, TurtlePositionAnswer(request.number, x, y, failure=failure))


def test_wall_turtle_waits_for_its_own_answer() -> None:
    run = Run(RosWallTurttleBot)
    run.board.add_message(ANSWER, TurtlePositionAnswer(7, 5.0, 5.0))  # to somebody's, long ago
    run.until(5000)
    assert run.entered[-1][1] == "STOP"
    assert run.board.get_message(REQUEST).number == 8
    answer(run, 5.0, 5.0)
    run.until(5010)
    assert run.entered[-1][1] == "STRAIGHT"


def test_wall_turtle_asks_again_after_a_failure() -> None:
    run = Run(RosWallTurttleBot)
    run.until(2500)
    first = run.board.get_message(REQUEST).number
    answer(run, 0, 0, failure="no pose yet")
    run.until(4000)
    assert run.entered[-1][1] == "STOP"
    assert run.board.get_message(REQUEST).number == first + 1
    answer(run, 5.0, 5.0)
    run.until(4010)
    assert run.entered[-1][1] == "STRAIGHT"


@pytest.mark.parametrize(
    ("x", "y", "away"),
    [(5.5, 5.5, True), (2.9, 5, False), (3.0, 5, True), (8.99, 5, True), (9.0, 5, False),
     (5, 2.9, False), (5, 3.0, True), (5, 8.99, True), (5, 9.0, False), (0.0, 11.08, False)],
)  # fmt: skip
def test_wall_turtle_turns_away_at_whole_metres(x: float, y: float, away: bool) -> None:
    run = Run(RosWallTurttleBot)
    run.until(2500)
    answer(run, x, y)
    run.until(3500)
    assert run.entered[-1][1] == ("STRAIGHT" if away else "TEST")
    run.until(4500)
    assert ("BACK" in [state for _, state in run.entered]) is not away


@pytest.mark.parametrize("machine", [RosBlindTurttleBot, RosWallTurttleBot])
def test_turtle_is_stopped_at_the_end(machine: type[Machine]) -> None:
    run = Run(machine)
    run.until(1500)
    assert run.board.get_message(CMD_VEL) != Twist()
    run.arrangement.stop()
    run.arrangement.run()
    assert run.entered[-1][1] == "END"
    assert run.board.get_message(CMD_VEL) == Twist()


def test_suspend_resume_stops_and_starts_the_other() -> None:
    run = Run(RosBlindTurttleBot, TurtleSuspendResume)
    run.until(100)
    assert run.arrangement.is_suspended("RosBlindTurttleBot")
    run.until(2900)
    assert run.arrangement.is_suspended("RosBlindTurttleBot")
    run.until(3100)
    assert run.arrangement.control.is_running("RosBlindTurttleBot")
    assert run.arrangement.state_name_of("TurtleSuspendResume") == "WATCH"
    run.until(8200)
    assert run.arrangement.is_suspended("RosBlindTurttleBot")


def test_suspend_resume_takes_its_target() -> None:
    arrangement = Arrangement(
        [RosPingPong, TurtleSuspendResume(target="RosPingPong")], whiteboard=Whiteboard.local(),
        clock=ManualClock(),
    )  # fmt: skip
    for _ in range(4):
        arrangement.round()
    assert arrangement.is_suspended("RosPingPong")


def test_wall_turtle_never_stays_at_a_wall() -> None:
    """Ten simulated minutes with the simulator: it comes near the walls and always turns away."""
    from llfsm.bridges.turtlesim.node import TurtlesimNode
    from llfsm.bridges.turtlesim.simulator import Simulator

    run = Run(RosWallTurttleBot)
    simulator = Simulator()
    node = TurtlesimNode(simulator, run.board)
    at_wall = longest = 0
    near = 0
    for _ in range(int(600 / 0.016)):
        node.step()
        run.arrangement.round()
        run.clock.advance(ms=16)
        x, y, *_ = simulator.turtles["turtle1"].pose
        distance = min(x, y, 11.088889 - x, 11.088889 - y)
        near += distance < 2
        at_wall = at_wall + 1 if distance <= 0 else 0
        longest = max(longest, at_wall)
    states = {state for _, state in run.entered}
    assert {"BACK", "TURN_RIGHT", "TEST"} <= states
    assert near > 100
    assert longest * 0.016 < 5
    assert math.isfinite(x)
