"""`llfsm bridge`: configurations that are wrong, wrong usage; the counts of its links."""

from __future__ import annotations

import importlib.util

import pytest
from click.testing import CliRunner

from llfsm.bridges.ros2.bridging.link import BridgeLink
from llfsm.bridges.ros2.transport import Notifier
from llfsm.cli.bridge.ros2 import Counts
from llfsm.cli.root import main
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist

GOOD = """\
[[relay]]
slot = "text"
type = "std_msgs/msg/String"
direction = "to_ros"
"""

BAD_FILES = {
    "direction = 1": ("1", "there is no key 'direction' here"),
    "[[relay]]\nslot = ": ("2", "Invalid value"),
    GOOD + 'topc = "x"': ("5", "there is no key 'topc' here"),
    GOOD.replace("to_ros", "away"): ("4", "away"),
    GOOD + "depth = 0": ("5", ">= 1"),
    GOOD + "rate = -1": ("5", "> 0"),
    GOOD + 'reliability = "so so"': ("5", "so so"),
    '[[relay]]\nslot = "a"\ndirection = "both"': ("1", "missing required field `type`"),
    GOOD.replace("String", "Strng"): ("3", "std_msgs/msg/String"),
    GOOD.replace('"text"', '"9"'): ("2", "'9'"),
    GOOD + GOOD: ("5", "twice"),
}


@pytest.fixture
def llfsm(board):
    """Run a command in this process, on the test's board; returns (status, output)."""

    def run(*arguments):
        command = ["bridge", *arguments, "--board", board]
        done = CliRunner().invoke(main, command, catch_exceptions=False)
        return done.exit_code, done.output

    return run


@pytest.mark.parametrize("text", BAD_FILES, ids=range(len(BAD_FILES)))
def test_what_is_wrong_in_a_file_is_reported_with_its_line(llfsm, tmp_path, text):
    file = tmp_path / "bridge.toml"
    file.write_text(text)
    line, what = BAD_FILES[text]
    status, printed = llfsm("ros2", "--config", str(file))
    assert status == 2
    assert f"{file}:{line}: " in printed
    assert what in printed
    assert printed.count("\n") == 1
    status, printed_by_check = llfsm("check", str(file))
    assert status == 2
    assert printed_by_check.removeprefix("Error: ") == printed.removeprefix("Error: ")


def test_check_reports_all_that_is_wrong(llfsm, tmp_path):
    file = tmp_path / "bridge.toml"
    file.write_text(GOOD.replace("String", "Strng") + GOOD.replace('"text"', '"9"'))
    status, printed = llfsm("check", str(file))
    assert status == 2
    assert [line.split(": ")[0] for line in printed.splitlines()] == [f"{file}:3", f"{file}:6"]
    status, printed = llfsm("ros2", "--config", str(file))
    assert status == 2
    assert printed.endswith("(and 1 more)\n")


def test_a_good_file_has_no_findings(llfsm, tmp_path):
    file = tmp_path / "bridge.toml"
    file.write_text(GOOD)
    assert llfsm("check", str(file)) == (0, "no findings\n")


def test_a_slot_of_another_schema_is_reported(llfsm, board, tmp_path):
    file = tmp_path / "bridge.toml"
    file.write_text(GOOD)
    with Whiteboard(board) as wb:
        wb.add_message(Slot("text", Twist), Twist())
        for command in (["check", str(file)], ["ros2", "--config", str(file)]):
            status, printed = llfsm(*command)
            assert status == 2
            assert f"{file}:2: slot 'text' holds geometry_msgs/msg/Twist" in printed


def test_a_file_that_is_not_there(llfsm, tmp_path):
    for command in (["check", str(tmp_path / "no")], ["ros2", "--config", str(tmp_path / "no")]):
        status, printed = llfsm(*command)
        assert status == 2
        assert "cannot be read" in printed


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["ros2"], "nothing to connect"),
        (["ros2", "--to-ros", "pinpong"], "--to-ros pinpong: write NAME:TYPE"),
        (["ros2", "--both", "a:std_msgs/msg/Strng"], "--both a:std_msgs/msg/Strng: "),
        (["ros2", "--to-ros", "9:std_msgs/msg/String"], "'9' is not a name"),
        (
            ["ros2", "--to-ros", "a:std_msgs/msg/String", "--from-ros", "/a:std_msgs/msg/String"],
            "--from-ros /a:std_msgs/msg/String: slot 'a' and topic /a are relayed both ways",
        ),
        (["ros2", "--to-ros", "a:std_msgs/msg/String", "--domain", "233"], "0<=x<=232"),
        (["turtlesim", "--turtle", "bad name"], "bad name"),
        (["turtlesim", "--turtle", "a", "--turtle", "a"], "twice"),
        (
            ["turtlesim", "--transport", "rclpy", "--router", "tcp/x:1"],
            "--router is for --transport zenoh",
        ),
    ],
)
def test_wrong_usage_is_reported(llfsm, arguments, what):
    status, printed = llfsm(*arguments)
    assert status == 2
    assert what in printed
    assert "Traceback" not in printed


def test_a_flag_beside_a_file_is_reported_by_itself(llfsm, tmp_path):
    file = tmp_path / "bridge.toml"
    file.write_text(GOOD)
    status, printed = llfsm("ros2", "--config", str(file), "--from-ros", "x:std_msgs/msg/Strng")
    assert status == 2
    assert printed.startswith("Error: --from-ros x:std_msgs/msg/Strng: ")


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is not None, reason="rclpy is here")
def test_rclpy_that_is_not_there_says_how_to_get_it(llfsm):
    status, printed = llfsm("turtlesim", "--transport", "rclpy")
    assert status == 1
    assert "source a ROS 2 environment" in printed
    assert printed.count("\n") == 1


def test_a_router_that_is_none_is_reported(llfsm):
    status, printed = llfsm("turtlesim", "--router", "nonsense")
    assert status == 1
    assert "nonsense" in printed


def test_a_domain_of_the_environment_that_is_none_is_wrong_usage(llfsm, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "many")
    status, printed = llfsm("turtlesim", "--transport", "zenoh")
    assert status == 2
    assert "ROS_DOMAIN_ID" in printed


def test_rates_are_those_of_the_last_second_or_more():
    now = [100.0]
    link = BridgeLink("pose", "<-", "/pose", "turtlesim/msg/Pose", Notifier(print))
    counts = Counts([link], lambda: now[0])
    for _ in range(50):
        link.count()
    now[0] += 0.5
    assert counts.read()[0].rate == 0.0  # too early to tell
    now[0] += 0.5
    assert counts.read()[0].rate == 50.0
    now[0] += 2.0
    assert counts.read()[0].rate == 0.0


def test_a_line_says_how_much_went_through_and_when():
    link = BridgeLink("pose", "<-", "/pose", "turtlesim/msg/Pose", Notifier(print))
    counts = Counts([link])
    assert str(counts.read()[0]) == "pose <- /pose: 0, 0.0/s"
    link.count()
    link.failed = 2
    assert str(counts.read()[0]).startswith("pose <- /pose: 1, 0.0/s, the last 0.")
    assert str(counts.read()[0]).endswith(" s ago, 2 failed")


def test_a_slot_too_small_for_a_sensor_is_a_warning_with_its_line(llfsm, tmp_path):
    file = tmp_path / "bridge.toml"
    image = GOOD.replace("std_msgs/msg/String", "sensor_msgs/msg/Image")
    file.write_text(image + "capacity = 65536\n")
    status, printed = llfsm("check", str(file))
    assert status == 0
    assert printed.startswith(f"{file}:5: warning: slot 'text' takes 65,536 bytes")
    assert "no findings" not in printed
    file.write_text(image)
    status, printed = llfsm("check", str(file))
    assert status == 0
    assert printed.startswith(f"{file}:3: note: slot 'text' takes up to 2,768,896 bytes")
    assert printed.endswith("\nno findings\n")


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["--ros-args", "-r", "a:b"], "--remap a:b: write [NODE:]FROM:=TO"),
        (["--ros-args", "--loud"], "--loud is not an argument of ROS"),
        (["--ros-args", "-r", "__ns:=1"], "'1' is not a namespace"),
        (["--node", "a b"], "'a b' is not a node name"),
    ],
)
def test_a_name_or_argument_of_ros_that_is_none_is_refused(llfsm, arguments, what):
    status, printed = llfsm("turtlesim", *arguments, *(["--"] if "--ros-args" in arguments else []))
    assert status == 2
    assert what in printed


def test_a_name_that_a_flag_gives_is_not_looked_for_in_the_file(llfsm, tmp_path):
    file = tmp_path / "bridge.toml"
    file.write_text('node = "wired"\n')
    status, printed = llfsm("ros2", "--config", str(file), "--node", "a b")
    assert status == 2
    assert printed.startswith("Error: --node: 'a b' is not a node name")
