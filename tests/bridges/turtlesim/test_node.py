"""The simulator on a board: commands in, poses out, positions on request."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from llfsm.bridges.turtlesim.node import TurtlesimNode
from llfsm.bridges.turtlesim.simulator import Simulator
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.turtle_sensor_poster import ANSWER, REQUEST, TurtlePositionRequest
from llfsm.whiteboard.messages.turtlesim import Color, Pose

AHEAD = Twist(linear=Vector3(x=2.0))


def cmd_vel(name: str) -> Slot[Twist]:
    return Slot(f"{name}/cmd_vel", Twist)


def pose(name: str) -> Slot[Pose]:
    return Slot(f"{name}/pose", Pose)


def test_each_turtle_obeys_its_own_slot() -> None:
    board, simulator = Whiteboard.local(), Simulator()
    simulator.spawn(2, 2, 0, "bob")
    node = TurtlesimNode(simulator, board)
    node.step()
    board.add_message(cmd_vel("bob"), AHEAD)
    node.step()
    assert board.get_message(pose("bob")).x == pytest.approx(2.032)
    assert board.get_message(pose("turtle1")).x == pytest.approx(5.544445)
    assert board.get_message(Slot("bob/color_sensor", Color)) is not None
    assert board[pose("bob")].count == 2


def test_a_command_is_obeyed_once() -> None:
    board = Whiteboard.local()
    node = TurtlesimNode(Simulator(), board)
    node.step()
    board.add_message(cmd_vel("turtle1"), AHEAD)
    for _ in range(100):
        node.step()
    assert board.get_message(pose("turtle1")).x == pytest.approx(5.544445 + 63 * 0.032)


def test_a_command_from_before_is_ignored() -> None:
    board = Whiteboard.local()
    board.add_message(cmd_vel("turtle1"), AHEAD)
    node = TurtlesimNode(Simulator(), board)
    node.step()
    assert board.get_message(pose("turtle1")).linear_velocity == 0


def test_a_turtle_spawned_later_is_served_and_a_killed_one_no_more() -> None:
    board, simulator = Whiteboard.local(), Simulator()
    node = TurtlesimNode(simulator, board)
    node.step()
    simulator.spawn(1, 1, 0, "late")
    node.step()
    assert board[pose("late")].count == 1
    simulator.kill("late")
    node.step()
    assert board[pose("late")].count == 1


def test_answers_carry_the_number_and_the_pose() -> None:
    board = Whiteboard.local()
    node = TurtlesimNode(Simulator(), board)
    node.step()
    assert board[ANSWER].count == 0
    board.add_message(REQUEST, TurtlePositionRequest(41))
    node.step()
    node.step()
    answer = board.get_message(ANSWER)
    assert board[ANSWER].count == 1
    assert (answer.number, answer.failure) == (41, "")
    assert (answer.x, answer.y) == pytest.approx((5.544445, 5.544445))


def test_without_the_turtle_the_answer_is_a_failure() -> None:
    board, simulator = Whiteboard.local(), Simulator()
    node = TurtlesimNode(simulator, board)
    simulator.kill("turtle1")
    board.add_message(REQUEST, TurtlePositionRequest(1))
    node.step()
    assert "turtle1" in board.get_message(ANSWER).failure


@pytest.mark.parametrize("slot", [cmd_vel("turtle1"), REQUEST], ids=lambda slot: slot.name)
def test_what_is_no_message_is_logged_once_and_ignored(
    tmp_path: Path, slot: Slot[Any], caplog: pytest.LogCaptureFixture
) -> None:
    """As a program with an encoder of its own might write it."""
    shm = pytest.importorskip("llfsm.whiteboard._shm", reason="the extension is hidden")
    with Whiteboard("board", directory=tmp_path) as board:
        node = TurtlesimNode(Simulator(), board)
        node.step()

        def junk(_: Any, buffer: bytearray) -> None:
            buffer[:] = b"\xc1"

        core = shm.Board(str(tmp_path / "llfsm.board"), True, -1)
        schema = json.dumps(slot.schema, separators=(",", ":"))
        kind = slot.name, slot.type_name, schema, slot.fingerprint, slot.capacity, slot.type
        port = shm.Port(core, *kind, (), junk, lambda _: slot.type())
        for _ in range(3):
            port.add(slot.type(number=1) if slot is REQUEST else slot.type())
            node.step()
        assert len(caplog.records) == 1
        assert slot.name in caplog.text
        board.add_message(cmd_vel("turtle1"), AHEAD)
        board.add_message(REQUEST, TurtlePositionRequest(number=7))
        node.step()
        assert board.get_message(pose("turtle1")).x > 5.55
        assert board.get_message(ANSWER).number == 7
