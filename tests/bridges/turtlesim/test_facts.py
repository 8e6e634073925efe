"""Facts measured on turtlesim 1.8.2: walls, time-outs, driving back, holonomic."""

from math import pi

import pytest

from llfsm.bridges.turtlesim.turtle import Level

# The heading towards each. A pose is rounded, so the state at the start is what was asked for.
WALLS = {"right": 0, "top": pi / 2, "left": pi, "bottom": -pi / 2, "corner": pi / 4}


@pytest.fixture
def facts(recorded):
    return recorded("turtlesim_facts.json")


def steps(simulator, count):
    """Step and return turtle1's poses."""
    poses = []
    for _ in range(count):
        simulator.step()
        poses.append(simulator.turtle("turtle1").pose)
    return poses


@pytest.mark.parametrize("wall", WALLS)
def test_wall(simulator, log, facts, wall):
    fact = facts["walls"][wall]
    simulator.teleport_absolute("turtle1", 5.5, 5.5, WALLS[wall])
    assert steps(simulator, 1)[0]._asdict() == fact["start"]
    poses = []
    while len(log) < fact["log_lines"]:
        simulator.command("turtle1", 2.0, 0.0, 0.0)
        poses += steps(simulator, 1)
    assert {level for level, _ in log} == {Level.WARN}
    texts = [text for _, text in log]
    assert texts[:2] == [line.partition("]: ")[2] for line in fact["log_first"]]
    assert texts[-1] == fact["log_last"][0].partition("]: ")[2]
    assert {pose.linear_velocity for pose in poses} == {2.0}
    for axis in ("x", "y"):
        reached = [getattr(pose, axis) for pose in poses]
        assert [min(reached), max(reached)] == fact[f"{axis}_range"]

    simulator.command("turtle1", 0.0, 0.0, 0.0)
    poses = steps(simulator, 1)
    assert poses[-1]._asdict() == fact["end"]


def test_a_turtle_begins_in_the_centre(simulator, facts):
    (pose,) = steps(simulator, 1)
    assert pose._asdict() == facts["initial_pose"]


@pytest.mark.parametrize("index", range(8))
def test_a_command_lasts_63_steps(simulator, facts, index):
    fact = facts["timeout"][index]
    simulator.reset()
    start = simulator.turtle("turtle1").pose
    command = fact["cmd"]
    simulator.command("turtle1", command.get("lx", 0.0), 0.0, command.get("az", 0.0))
    poses = steps(simulator, 100)
    moving = [pose for pose in poses if (pose.linear_velocity, pose.angular_velocity) != (0, 0)]
    assert len(moving) == fact["moving_poses"] == 63
    assert moving == poses[:63]
    assert poses[-1].x - start.x == fact["displacement_x"]
    assert poses[-1].theta - start.theta == fact["displacement_theta"]


def test_a_newer_command_lasts_63_steps_from_then(simulator):
    simulator.command("turtle1", 1.0, 0.0, 0.0)
    steps(simulator, 40)
    simulator.command("turtle1", 2.0, 0.0, 0.0)
    speeds = [pose.linear_velocity for pose in steps(simulator, 70)]
    assert speeds == [2.0] * 63 + [0.0] * 7


def test_driving_back_reports_a_speed_without_sign(simulator, facts):
    fact = facts["backwards"]
    simulator.command("turtle1", -2.0, 0.0, 0.0)
    poses = steps(simulator, 100)
    assert poses[-1]._asdict() == fact["end"]
    assert sorted({pose.linear_velocity for pose in poses}) == fact["velocity_reported"]


@pytest.mark.parametrize("holonomic", [False, True])
def test_linear_y_counts_only_when_holonomic(simulator, facts, holonomic):
    fact = facts[f"linear_y_holonomic_{holonomic}".lower()]
    simulator.parameters.set("holonomic", holonomic)
    assert steps(simulator, 1)[0]._asdict() == fact["start"]
    simulator.command("turtle1", 0.0, 1.0, 0.0)
    assert steps(simulator, 100)[-1]._asdict() == fact["end"]
