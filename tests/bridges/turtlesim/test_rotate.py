"""The action rotate_absolute: its goals, feedback and ends."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.turtlesim.simulator import Simulator
from llfsm.bridges.turtlesim.turtle import Level
from llfsm.runtime.goals import GoalStatus


def follow(simulator, goal, steps=10_000):
    """Step until the goal ends, at most `steps` times, and return its feedback."""
    feedback = []
    while goal.active and len(feedback) < steps:
        simulator.step()
        if goal.status is not GoalStatus.CANCELED:
            feedback.append(goal.remaining)
    return feedback


def test_recorded_goals(recorded, simulator, log):
    turtle = simulator.turtle("turtle1")
    for record in recorded("turtlesim_action.json"):
        label = record["label"]
        log.clear()
        assert turtle.pose._asdict() == record["start"], label
        goal = simulator.rotate_absolute("turtle1", record["goal_theta"])
        assert goal.status is GoalStatus.EXECUTING
        if "after 0.5 s" in label:
            feedback = follow(simulator, goal, steps=32)
            if "cancelled" in label:
                assert goal.cancel()
                assert goal.status is GoalStatus.CANCELING
                assert follow(simulator, goal) == []
            else:
                simulator.command("turtle1", 0.5, 0.0, 0.0)
                for _ in range(4):  # when the recorder looked
                    simulator.step()
        else:
            feedback = follow(simulator, goal)
            simulator.step()
        assert goal.status == record["status"], label
        assert goal.delta == record["delta"], label
        assert len(feedback) == record["feedback_count"], label
        assert feedback[:2] == record["feedback_first"], label
        assert feedback[-2:] == record["feedback_last"], label
        assert turtle.pose._asdict() == record["end"], label
        expected = re.fullmatch(r"\[(\w+)\] \[.*\] \[turtlesim\]: (.*)", *record["log"]).groups()
        assert [(level.name, text) for level, text in log] == [expected], label
        for _ in range(60):  # until the command that ended the goal has ended
            simulator.step()


def test_a_newer_goal_aborts_the_one_before(simulator, log):
    first = simulator.rotate_absolute("turtle1", 3.0)
    follow(simulator, first, steps=10)
    second = simulator.rotate_absolute("turtle1", -1.0)
    assert first.status is GoalStatus.ABORTED
    assert first.delta == pytest.approx(-9 * 0.016)
    text = "Rotation goal received before a previous goal finished. Aborting previous goal"
    assert log == [(Level.WARN, text)]
    follow(simulator, second)
    assert second.status is GoalStatus.SUCCEEDED


@pytest.mark.parametrize("end", ["kill", "reset"])
def test_a_goal_whose_turtle_goes_is_cancelled(simulator, end):
    goal = simulator.rotate_absolute("turtle1", 3.0)
    simulator.step()
    if end == "kill":
        simulator.kill("turtle1")
    else:
        simulator.reset()
    assert goal.status is GoalStatus.CANCELED


def test_delta_is_wrapped_where_the_turn_crosses_pi(simulator):
    simulator.teleport_absolute("turtle1", 5.0, 5.0, 3.0)
    simulator.step()
    goal = simulator.rotate_absolute("turtle1", -3.0)
    follow(simulator, goal)
    assert goal.status is GoalStatus.SUCCEEDED
    assert goal.delta == pytest.approx(6.0 - math.tau, abs=0.02)


def test_an_ended_goal_cannot_be_cancelled(simulator):
    goal = simulator.rotate_absolute("turtle1", 0.0)
    simulator.step()
    assert goal.status is GoalStatus.SUCCEEDED
    assert not goal.cancel()
    assert goal.status is GoalStatus.SUCCEEDED


def test_turning_stops_what_the_turtle_was_doing(simulator):
    simulator.command("turtle1", 2.0, 0.0, 0.0)
    goal = simulator.rotate_absolute("turtle1", 1.0)
    simulator.step()
    pose = simulator.turtle("turtle1").pose
    assert (pose.x, pose.linear_velocity, pose.angular_velocity) == (5.544444561004639, 0.0, 1.0)
    assert goal.active


@given(st.floats(-10, 10), st.floats(-3, 3))
def test_a_goal_is_reached_by_the_shorter_way(theta, start):
    simulator = Simulator()
    simulator.teleport_absolute("turtle1", 5.0, 5.0, start)
    simulator.step()
    goal = simulator.rotate_absolute("turtle1", theta)
    feedback = follow(simulator, goal)
    assert goal.status is GoalStatus.SUCCEEDED
    assert len(feedback) <= math.pi / 0.016 + 2
    assert abs(goal.remaining) < 0.02 + 1e-6
    missed = math.remainder(simulator.turtle("turtle1").pose.theta - theta, math.tau)
    assert abs(missed) < 0.02 + 1e-6
