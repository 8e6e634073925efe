"""The parameters of our node: recorded answers, and what follows from them."""

from __future__ import annotations

import pytest

from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos

KINDS = {bool: (1, "bool_value"), int: (2, "integer_value"), str: (4, "string_value")}
CASES = {
    "set background_r=150": ("background_r", 150),
    "set background_r=300": ("background_r", 300),
    'set background_r="red"': ("background_r", "red"),
    "set holonomic=1 (int)": ("holonomic", 1),
    "set nosuch=1": ("nosuch", 1),
    "set background_r=69 (default)": ("background_r", 69),
}


def parameter(ros, name, value):
    kind, field = KINDS[type(value)]
    held = ros.types.message("rcl_interfaces/msg/ParameterValue").message
    made = ros.types.message("rcl_interfaces/msg/Parameter").message
    return made(name=name, value=held(type=kind, **{field: value}))


def set_one(ros, name, value):
    service = "/turtlesim/set_parameters"
    wanted = (parameter(ros, name, value),)
    (result,) = ros.call(service, "rcl_interfaces/srv/SetParameters", parameters=wanted).results
    return {"successful": result.successful, "reason": result.reason}


def get(ros, *names):
    service = "/turtlesim/get_parameters"
    return ros.call(service, "rcl_interfaces/srv/GetParameters", names=names).values


def test_recorded_answers(ros, recorded):
    recordings = recorded("graph.json")["parameter_set_tests"]
    assert recordings.pop("get nosuch") == {"values": list(get(ros, "nosuch"))}
    assert set(recordings) == set(CASES)
    for label, (name, value) in CASES.items():
        assert recordings[label] == {"results": [set_one(ros, name, value)]}, label


def test_the_background_follows(ros):
    assert set_one(ros, "background_g", 0)["successful"]
    assert ros.turtlesim.simulator.parameters.background == (69, 0, 255)
    assert [value.integer_value for value in get(ros, "background_r", "background_g")] == [69, 0]


@pytest.mark.parametrize("holonomic", [False, True])
def test_holonomic_moves_a_turtle_sideways(ros, recorded, holonomic):
    truth = recorded("turtlesim_facts.json")[f"linear_y_holonomic_{str(holonomic).lower()}"]
    if holonomic:
        assert {"results": [set_one(ros, "holonomic", True)]} == truth["set"]
    poses = ros.hear("/turtle1/pose", "turtlesim/msg/Pose")
    ros.command(y=1.0)
    ros.step(64)
    ros.until(lambda: len(poses) == 64)
    seen = {name: getattr(poses[-1], name) for name in truth["end"]}
    assert seen == truth["end"]


def test_a_change_is_reported(ros):
    events = ros.hear("/parameter_events", "rcl_interfaces/msg/ParameterEvent")
    set_one(ros, "background_b", 300)
    set_one(ros, "background_b", 7)
    ros.until(lambda: events)
    (event,) = events
    assert event.node == "/turtlesim"
    ((name, value),) = ((one.name, one.value) for one in event.changed_parameters)
    assert (name, value.type, value.integer_value) == ("background_b", 2, 7)


PARAMETERS = """
background_b background_g background_r holonomic
qos_overrides./parameter_events.publisher.depth
qos_overrides./parameter_events.publisher.durability
qos_overrides./parameter_events.publisher.history
qos_overrides./parameter_events.publisher.reliability
start_type_description_service use_sim_time
"""
"""What `ros2 param list` prints of turtlesim_node on Jazzy."""


def test_every_parameter_of_the_real_node_is_listed_has_a_value_and_is_described(ros):
    found = ros.call("/turtlesim/list_parameters", "rcl_interfaces/srv/ListParameters")
    assert list(found.result.names) == PARAMETERS.split()
    values = get(ros, *found.result.names)
    assert [value.type for value in values] == [2, 2, 2, 1, 2, 4, 4, 4, 1, 1]
    assert [value.string_value for value in values[5:8]] == ["volatile", "keep_last", "reliable"]
    described = ros.call(
        "/turtlesim/describe_parameters",
        "rcl_interfaces/srv/DescribeParameters",
        names=found.result.names,
    ).descriptors
    assert [one.name for one in described] == PARAMETERS.split()
    assert [one.name for one in described if one.read_only] == PARAMETERS.split()[4:9]
    assert described[2].description == "Red channel of the background color"


def test_deleting_a_parameter_is_refused_as_by_rclcpp(ros):
    held = ros.types.message("rcl_interfaces/msg/ParameterValue").message
    made = ros.types.message("rcl_interfaces/msg/Parameter").message
    wanted = (made(name="background_r", value=held()),)
    answer = ros.call(
        "/turtlesim/set_parameters", "rcl_interfaces/srv/SetParameters", parameters=wanted
    )
    assert answer.results[0].reason == "cannot undeclare a statically typed parameter"


def test_a_log_line_names_the_code_that_logged_it(ros):
    late = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=100)
    lines = ros.hear("/rosout", "rcl_interfaces/msg/Log", late)
    ros.call("/clear", "std_srvs/srv/Empty")
    ros.until(lambda: any("Clearing" in line.msg for line in lines))
    (line,) = (line for line in lines if "Clearing" in line.msg)
    assert (line.name, line.level, line.function) == ("turtlesim", 20, "clear")
    assert line.file.endswith("simulator.py")
    assert line.line > 0
