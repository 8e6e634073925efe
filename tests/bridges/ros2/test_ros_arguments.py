"""What stands after --ros-args is understood as rcl understands it."""

from __future__ import annotations

import logging

import pytest

from llfsm.bridges.ros2.errors import RosArgumentError
from llfsm.bridges.ros2.node_parameters import fits, read_value
from llfsm.bridges.ros2.ros_arguments import RosArguments, split_ros_arguments


def ros(*arguments):
    own, found = split_ros_arguments(["--ros-args", *arguments])
    assert own == []
    return found


def test_a_program_keeps_its_own_arguments():
    given = "a -r b --ros-args -r x:=y -- c -p d --ros-args --ros-args -e /e".split()  # noqa: SIM905
    own, found = split_ros_arguments(given)
    assert own == ["a", "-r", "b", "c", "-p", "d"]
    assert found.names("n").full("x") == "/y"
    assert found.enclave == "/e"
    assert split_ros_arguments(["run", "--", "-v"]) == (["run", "--", "-v"], RosArguments())


@pytest.mark.parametrize(
    ("rules", "names"),
    [
        (["__node:=other"], "/other /x /other/y"),
        (["__name:=other"], "/other /x /other/y"),
        (["__ns:=/a/b"], "/a/b/robot /a/b/x /a/b/robot/y"),
        (["robot:__node:=other", "who:__ns:=/a"], "/other /x /other/y"),
        (["x:=/to", "~/y:=z"], "/robot /to /z"),
        (["__ns:=/a", "x:=z"], "/a/robot /a/z /a/robot/y"),
        (["x:=first", "x:=second"], "/robot /first /robot/y"),
        (["x:=robot/y", "robot/y:=x"], "/robot /robot/y /x"),
        (["rosservice://x:=z", "rostopic://~/y:=q"], "/robot /x /q"),
        (["robot:x:=z", "who:x:=q"], "/robot /z /robot/y"),
        (["__node:=other", "robot:x:=z", "other:~/y:=q"], "/other /x /q"),
        (["__node:=other", "other:__ns:=/a", "robot:__ns:=/b"], "/a/other /a/x /a/other/y"),
    ],
)
def test_remapping(rules, names):
    found = ros(*(each for rule in rules for each in ("-r", rule))).names("robot")
    assert [found.full_node, found.full("x"), found.full("~/y")] == names.split()


def test_services_are_remapped_apart_from_topics():
    found = ros("--remap", "rosservice://x:=z", "--remap", "y:=w").names("robot")
    assert [found.full_service("x"), found.full("x")] == ["/z", "/x"]
    assert [found.full_service("y"), found.full("y")] == ["/w", "/w"]


def test_a_second_node_is_renamed_only_by_its_own_rule():
    found = ros("-r", "__node:=a", "-r", "__ns:=/b")
    assert found.names("second", only_one=False).full_node == "/b/second"
    found = ros("-r", "second:__node:=a")
    assert found.names("second", only_one=False).full_node == "/a"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("true", True), ("Off", False), ("'true'", "true"), ('"1"', "1"), ("1", 1), ("-0x1F", -31),
        ("010", 8), ("08", 8.0), ("1.5", 1.5), ("1e3", 1000.0), ("1.", 1.0), (".5", 0.5),
        (".inf", float("inf")), ("-.INF", float("-inf")), ("one", "one"), ("a b", "a b"),
        ("9223372036854775808", 9223372036854775808.0), ("[1, 2]", (1, 2)), ("[]", ()),
        ("[true, no]", (True, False)), ("['1', b]", ("1", "b")), ("null", "null"), ("''", ""),
        ("inf", float("inf")), ("-Infinity", float("-inf")), ("info", "info"), ("'inf'", "inf"),
        ("!!str 5", "5"), ("!!str true", "true"), ("!!float 5", 5), ("yes", True),
    ],
)  # fmt: skip
def test_values_have_the_type_that_rcl_gives_them(text, value):
    read = read_value(text, "x")
    assert (read, type(read)) == (value, type(value))


def test_parameters_are_for_the_nodes_that_their_patterns_fit(tmp_path):
    file = tmp_path / "params.yaml"
    file.write_text(
        """\
/**:
  ros__parameters:
    every: 1
    speed: 1.0
robot:
  ros__parameters:
    speed: 2.0
    arm: {length: 3, names: [a, b]}
ns:
  robot:
    ros__parameters: {speed: 4.0}
/*/other:
  ros__parameters: {some: true}
"""
    )
    found = ros("--params-file", str(file), "-p", "last:=x", "-p", "robot:only:=1")
    assert found.parameters("/robot") == {
        "every": 1,
        "speed": 2.0,
        "arm.length": 3,
        "arm.names": ("a", "b"),
        "last": "x",
        "only": 1,
    }
    assert found.parameters("/ns/robot") == {"every": 1, "speed": 4.0, "last": "x"}
    assert found.parameters("/ns/other") == {"every": 1, "speed": 1.0, "some": True, "last": "x"}
    assert ros("-p", "speed:=3.0", "--params-file", str(file)).parameters("/robot")["speed"] == 2.0


def test_of_parameters_that_stand_apart_those_of_one_pattern_count_where_the_first_is(tmp_path):
    file = tmp_path / "params.yaml"
    file.write_text("robot:\n  ros__parameters: {speed: 1}\n")
    found = ros("-p", "speed:=2", "--params-file", str(file), "-p", "speed:=3", "-p", "b:=1")
    assert found.parameters("/robot") == {"speed": 1, "b": 1}


def test_patterns():
    assert fits("/**", "/a/b")
    assert fits("/a/**", "/a/b/c")
    assert fits("/*/c", "/b/c")
    assert not fits("/*/c", "/a/b/c")
    assert not fits("/a.b", "/axb")


@pytest.mark.parametrize(
    ("arguments", "level"),
    [
        ("", logging.INFO),
        ("--log-level debug", logging.DEBUG),
        ("--log-level debug --log-level FATAL", logging.CRITICAL),
        ("--log-level rcl:=WARN", logging.INFO),
        ("--log-level team.robot:=WARN", logging.WARNING),
        ("--log-level team:=error --log-level debug", logging.ERROR),
        ("--log-level team:=error --log-level team.robot:=debug", logging.DEBUG),
        ("--log-level team:=error --log-level team.robot:=unset", logging.ERROR),
        ("--log-level team.robot.arm:=error --log-level tea:=error", logging.INFO),
    ],
)
def test_a_log_level_is_that_of_the_nodes_logger(arguments, level):
    assert ros(*arguments.split()).log_level("/team/robot") == level


def test_logs_may_be_switched_off():
    found = ros("--disable-rosout-logs", "--disable-stdout-logs", "--disable-external-lib-logs")
    assert (found.rosout, found.stdout) == (False, False)
    assert ros("--disable-stdout-logs", "--enable-stdout-logs").stdout
    assert ros("--log-file-name", "robot", "--log-config-file", "none") == RosArguments()


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["-r"], "-r: its value is missing"),
        (["-r", "a:b"], r"--remap a:b: write \[NODE:\]FROM:=TO"),
        (["-r", ":=b"], "--remap :=b"),
        (["-p", "a:="], "--param a:="),
        (["-p", "a:=[1, x]"], "a sequence has values of one type"),
        (["-p", "a:={b: c}"], "expected a value"),
        (["-p", "a:=[1"], "not YAML"),
        (["--log-level", "loud"], "--log-level loud: not one of"),
        (["--log-level", ":=info"], r"--log-level :=info: write \[LOGGER:=\]LEVEL"),
        (["--what"], "--what is not an argument of ROS"),
        (["--params-file", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
    ],
)
def test_what_is_wrong_is_reported(arguments, what):
    with pytest.raises(RosArgumentError, match=what):
        ros(*arguments)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("a: [1", "not YAML"),
        ("ros__parameters: {a: 1}", ":1: ros__parameters belongs below"),
        ("a:\n  ros__parameters:\n    x: [1, b]\n", ":3: a sequence"),
        ("a:\n  ros__parameters:\n    x:\n", ":3: a value is missing"),
        ("a: 1\n", ":1: expected names"),
        ("a:\n  b*: {ros__parameters: {a: 1}}\n", r":2: 'b\*' is not a node's name"),
        ("a//b:\n  ros__parameters: {a: 1}\n", ":1: 'a//b' is not a node's name"),
    ],
)
def test_what_is_wrong_in_a_file_is_reported_with_its_line(tmp_path, text, what):
    file = tmp_path / "params.yaml"
    file.write_text(text)
    with pytest.raises(RosArgumentError, match=what):
        ros("--params-file", str(file))


@pytest.mark.parametrize(
    "rule",
    [
        "__node:=a b", "__node:=a/b", "__ns:=1", "__ns:=a", "__ns:=/a/", "x:=a//b", "other:1:=a",
        "~:=a", "*:=a", "a/**:=b", "/__node:=a", "a.b:=c", "a:=/", "a:=rostopic://b", r"(.*):=\1",
        "a/b:c:=d", "__a:=b", "a__b:=c",
    ],
)  # fmt: skip
def test_a_rule_with_a_name_that_is_none_is_refused(rule):
    with pytest.raises(RosArgumentError, match="--remap"):
        ros("-r", rule)


@pytest.mark.parametrize("rule", ["*:=1", "a..b:=1", "a-b:=1", "9:=1", "/n:a:=1", "a.b:c:=1"])
def test_a_parameter_with_a_name_that_is_none_is_refused(rule):
    with pytest.raises(RosArgumentError, match="is not the name of a parameter"):
        ros("-p", rule)


@pytest.mark.parametrize("enclave", ["", "a", "/a//b", "/a/", "/1"])
def test_an_enclave_that_is_none_is_refused(enclave):
    with pytest.raises(RosArgumentError, match="is not an enclave"):
        ros("-e", enclave)
