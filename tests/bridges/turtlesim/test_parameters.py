"""Parameters are refused in the words that rclcpp was recorded with."""

import pytest

from llfsm.bridges.turtlesim.canvas import Rgb
from llfsm.bridges.turtlesim.errors import TurtlesimError
from llfsm.bridges.turtlesim.parameters import Parameters

CASES = {
    "set background_r=150": ("background_r", 150),
    "set background_r=300": ("background_r", 300),
    'set background_r="red"': ("background_r", "red"),
    "set holonomic=1 (int)": ("holonomic", 1),
    "set nosuch=1": ("nosuch", 1),
    "set background_r=69 (default)": ("background_r", 69),
}


def test_recorded_answers(recorded):
    parameters = Parameters()
    answers = recorded("graph.json")["parameter_set_tests"]
    for label, (name, value) in CASES.items():
        ((answer,),) = answers[label].values()
        if answer["successful"]:
            parameters.set(name, value)
            assert parameters.values()[name] == value
        else:
            with pytest.raises(TurtlesimError) as caught:
                parameters.set(name, value)
            assert str(caught.value) == answer["reason"]


def test_a_refused_value_changes_nothing():
    parameters = Parameters()
    before = parameters.values()
    for name, value in [("background_b", -1), ("background_g", True), ("holonomic", None)]:
        with pytest.raises(TurtlesimError):
            parameters.set(name, value)
    assert parameters.values() == before
    assert before == {
        "background_r": 69,
        "background_g": 86,
        "background_b": 255,
        "holonomic": False,
    }


def test_what_the_simulator_reads_follows():
    parameters = Parameters()
    parameters.set("background_g", 0)
    parameters.set("holonomic", True)
    assert parameters.background == Rgb(69, 0, 255)
    assert parameters.holonomic is True
