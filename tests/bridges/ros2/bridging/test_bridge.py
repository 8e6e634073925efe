"""A bridge as a whole: its end."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import msgspec
import pytest

from llfsm.bridges.ros2.bridging.bridge import Bridge
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig
from llfsm.bridges.ros2.bridging.bridge_plan import make_plan
from llfsm.whiteboard import Slot, SlotTypeError
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.std_msgs import Bool
from memory_transport import MemoryTransport
from waiting import PATIENCE_S

TO_ROS = {"slot": "lamp", "type": "std_msgs/msg/Bool", "direction": "to_ros"}
LAMP = Slot("lamp", Bool)

COMMANDER = """
import sys
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Bool
with Whiteboard("test", directory=sys.argv[1]) as board:
    board.add_message(Slot("lamp", Bool), Bool(True))
    print("added", flush=True)
    sys.stdin.read()
    board.add_message(Slot("lamp", Bool), Bool(False))
"""


FOR_EVER = 1000.0


@pytest.fixture
def commander(board, tmp_path):
    """Start a process that has commanded something through the slot `lamp`, and lives."""
    command = [sys.executable, "-c", COMMANDER, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"added\n"
        yield process
        process.kill()


def test_a_bridge_lingers_while_a_process_lives_that_may_command_a_stop(start, commander):
    bridge = start(relay=[TO_ROS])
    lingering = threading.Thread(target=bridge.linger, args=(FOR_EVER,), daemon=True)
    lingering.start()
    lingering.join(0.2)
    assert lingering.is_alive()
    commander.kill()
    lingering.join(PATIENCE_S)
    assert not lingering.is_alive()


def test_a_bridge_through_which_nothing_is_commanded_ends_at_once(start, board):
    bridge = start(relay=[TO_ROS, {**TO_ROS, "slot": "never"}])
    board.add_message(LAMP, Bool(True))  # by this process
    bridge.linger(FOR_EVER)


@pytest.mark.usefixtures("commander")
def test_a_bridge_lingers_only_so_long(start):
    start(relay=[TO_ROS]).linger(0.1)


@pytest.mark.usefixtures("commander")
def test_a_bridge_on_a_board_that_was_removed_ends(start, board):
    bridge = start(relay=[TO_ROS], turtle_position={"pose": "turtle1/pose"})
    board.remove()
    bridge.linger(FOR_EVER)
    bridge.close()


def test_what_a_process_adds_as_its_board_was_removed_is_published(
    start, board, peer, seen, types, commander
):
    got = seen()
    of = types.message("std_msgs/msg/Bool")
    peer.node("robot").subscription("lamp", of, lambda each: got(each.decode().data))
    before = {*threading.enumerate()}
    bridge = start(relay=[TO_ROS])
    (follower,) = (
        each for each in {*threading.enumerate()} - before if "subscription" in each.name
    )
    remove_board(board.name, board.path.parent)
    follower.join(PATIENCE_S)  # it notices, as nothing is added for a while
    assert not follower.is_alive()
    commander.stdin.close()
    bridge.linger(FOR_EVER)
    bridge.close()
    got.wait(lambda got: got == [False])


def test_a_bridge_that_cannot_begin_leaves_nothing_behind(board, memory, peer):
    """Another process makes a slot between the plan and the bridge."""
    relays = [{**TO_ROS, "slot": "first", "type": "std_msgs/msg/String"}, TO_ROS]
    plan, faults = make_plan(msgspec.convert({"relay": relays}, BridgeConfig), Path(), [])
    assert not faults
    board.add_message(Slot("lamp", Twist), Twist())
    with (
        MemoryTransport(memory) as transport,
        pytest.raises(SlotTypeError, match="geometry_msgs/msg/Twist"),
    ):
        Bridge(plan, board, transport)
    assert not peer.graph().nodes
