"""The parameters of our node: recorded answers, and what follows from them."""

from __future__ import annotations

import pytest

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


def test_a_change_is_told(ros):
    events = ros.hear("/parameter_events", "rcl_interfaces/msg/ParameterEvent")
    set_one(ros, "background_b", 300)
    set_one(ros, "background_b", 7)
    ros.until(lambda: events)
    (event,) = events
    assert event.node == "/turtlesim"
    ((name, value),) = ((one.name, one.value) for one in event.changed_parameters)
    assert (name, value.type, value.integer_value) == ("background_b", 2, 7)
