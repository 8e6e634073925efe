"""A bridge as a whole: its end."""

from __future__ import annotations

import subprocess
import sys
import threading

import pytest

from llfsm.bridges.ros2.bridging import bridge as module
from llfsm.bridges.ros2.bridging.planning import make_plan
from llfsm.whiteboard import Slot, SlotTypeError
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.std_msgs import Bool

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
"""


@pytest.fixture
def for_ever(monkeypatch):
    """Let a bridge linger as long as it likes."""
    monkeypatch.setattr(module, "_LINGER_S", 1000.0)


def test_a_bridge_lingers_while_somebody_lives_who_may_command_a_stop(
    start, board, tmp_path, for_ever
):
    bridge = start(relay=[TO_ROS])
    command = [sys.executable, "-c", COMMANDER, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as commander:
        assert commander.stdout is not None
        assert commander.stdout.readline() == b"added\n"
        lingering = threading.Thread(target=bridge.linger, daemon=True)
        lingering.start()
        lingering.join(0.2)
        assert lingering.is_alive()
        commander.kill()
    lingering.join(20)
    assert not lingering.is_alive()


def test_a_bridge_that_nobody_commands_through_ends_at_once(start, board, for_ever):
    bridge = start(relay=[TO_ROS, {**TO_ROS, "slot": "never"}])
    board.add_message(LAMP, Bool(True))  # by this process
    bridge.linger()


def test_a_bridge_lingers_only_so_long(start, board, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_LINGER_S", 0.1)
    monkeypatch.setattr(module, "_lives", lambda _: True)
    bridge = start(relay=[TO_ROS])
    board.add_message(LAMP, Bool(True))
    bridge.linger()


def test_a_bridge_on_a_board_that_was_removed_ends(start, board, for_ever, monkeypatch):
    monkeypatch.setattr(module, "_lives", lambda _: True)
    bridge = start(relay=[TO_ROS], turtle_position={"pose": "turtle1/pose"})
    board.add_message(LAMP, Bool(True))
    board.remove()
    bridge.linger()
    bridge.close()


def test_a_bridge_that_cannot_begin_leaves_nothing_behind(start, board, peer, monkeypatch):
    """Somebody makes a slot between the plan and the bridge."""

    def late(*arguments):
        made = make_plan(*arguments)
        board.add_message(Slot("lamp", Twist), Twist())
        return made

    monkeypatch.setitem(start.__globals__, "make_plan", late)
    with pytest.raises(SlotTypeError, match="geometry_msgs/msg/Twist"):
        start(relay=[{**TO_ROS, "slot": "first", "type": "std_msgs/msg/String"}, TO_ROS])
    assert not peer.graph().nodes
