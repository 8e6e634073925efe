"""Runs recorded from turtlesim 1.8.2 replay bit for bit."""

import json
from pathlib import Path

import pytest

from llfsm.bridges.turtlesim.simulator import Simulator

RUNS = sorted((Path(__file__).parents[2] / "data" / "turtlesim").glob("*.jsonl"))


def test_the_runs_are_there():
    assert len(RUNS) == 5


@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.stem)
def test_replayed_poses_are_identical(path):
    head, *records = map(json.loads, path.read_text().splitlines())
    start = head["start"]
    simulator = Simulator()
    simulator.teleport_absolute("turtle1", start["x"], start["y"], start["theta"])
    waiting = []
    poses = 0
    for record in records:
        if record["k"] == "cmd":
            waiting.append(record)
            continue
        # A command applied at the first later pose that reports its speeds.
        while waiting and (abs(waiting[0]["linear_x"]), waiting[0]["angular_z"]) == (
            record["v"],
            record["w"],
        ):
            command = waiting.pop(0)
            simulator.command(
                "turtle1", command["linear_x"], command["linear_y"], command["angular_z"]
            )
        simulator.step()
        pose = simulator.turtle("turtle1").pose
        assert pose == tuple(record[key] for key in ("x", "y", "theta", "v", "w")), poses
        poses += 1
    assert not waiting
    assert poses >= 100
    assert pose == tuple(head["end"].values())


@pytest.mark.parametrize("run", range(4))
def test_poses_are_those_of_a_compiled_model(recorded, run):
    """Compare with turtlesim's types and order of operations compiled as C++, after any requests.

    The recorded runs are few and short; here every rounding and regrouping shows.
    """
    data = recorded("compiled_runs.json")[run]
    simulator = Simulator()
    poses = iter(data["poses"])
    for number, (name, *arguments) in enumerate(data["script"]):
        if name == "step":
            for _ in range(*arguments):
                simulator.step()
            assert list(simulator.turtle("turtle1").pose) == next(poses), number
        elif name == "holonomic":
            simulator.parameters.set("holonomic", *arguments)
        elif name == "respawn":
            simulator.kill("turtle1")
            simulator.spawn(*arguments, "turtle1")
        else:
            getattr(simulator, name)("turtle1", *arguments)
    assert next(poses, None) is None
