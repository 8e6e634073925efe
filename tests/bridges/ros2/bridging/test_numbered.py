"""Messages of services in slots."""

from __future__ import annotations

import pytest

from llfsm.bridges.ros2.bridging.service_slots import from_slot, into_slot, service_slots
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.turtle_sensor_poster import ANSWER, REQUEST


def test_those_of_the_turtle_position_are_the_ones_that_ship(types):
    made = service_slots(
        "turtle_position", types.service("turtle_sensor_poster/srv/TurtlePosition")
    )
    assert (made.request.name, made.answer.name) == (REQUEST.name, ANSWER.name)
    assert made.request.fingerprint == REQUEST.fingerprint
    assert made.answer.fingerprint == ANSWER.fingerprint


@pytest.mark.parametrize(
    "name",
    [
        "turtlesim/srv/Spawn",
        "turtlesim/srv/SetPen",
        "std_srvs/srv/Empty",
        "std_srvs/srv/Trigger",
        "rcl_interfaces/srv/SetParameters",
        "action_msgs/srv/CancelGoal",
    ],
)
def test_any_service_goes_to_slots_and_back(types, name):
    of = types.service(name)
    slots = service_slots("s", of)
    request, response = of.request.message(), of.response.message()
    asked, answered = into_slot(slots.request, 3, request), into_slot(slots.answer, 4, response)
    assert (asked.number, answered.number, answered.failure) == (3, 4, "")
    assert from_slot(slots.of.request, asked) == request
    assert from_slot(slots.of.response, answered) == response
    board = Whiteboard.local()
    assert board.add_message(slots.request, asked) == 1
    assert board.add_message(slots.answer, slots.failed(5, "no")) == 1


def test_fields_that_are_called_like_ours_step_aside(tmp_path):
    folder = tmp_path / "own_msgs" / "srv"
    folder.mkdir(parents=True)
    (folder / "Odd.srv").write_text(
        "int32 number\nstring failure\n---\nstring failure\nint32 number\n"
    )
    of = TypeLibrary(share=[tmp_path]).service("own_msgs/srv/Odd")
    slots = service_slots("odd", of)
    assert slots.request.type.__struct_fields__ == ("number", "number_", "failure_")
    assert slots.answer.type.__struct_fields__ == ("number", "failure_", "number_", "failure")
    request = of.request.message(number=5, failure="x")
    assert from_slot(slots.of.request, into_slot(slots.request, 1, request)) == request
    response = of.response.message(number=5, failure="x")
    assert from_slot(slots.of.response, into_slot(slots.answer, 1, response)) == response
