"""Runs recorded from turtlesim 1.8.2 replay bit for bit through a ROS graph."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

RUNS = sorted((Path(__file__).parents[2] / "data" / "turtlesim").glob("*.jsonl"))
OVER_THE_WIRE = "turtlesim_i_zigzag_0"


def test_the_runs_are_there():
    assert len(RUNS) == 5
    assert OVER_THE_WIRE in {path.stem for path in RUNS}


@pytest.mark.parametrize(
    ("path", "ros"),
    [
        *((path, "memory") for path in RUNS),
        *((path, "zenoh") for path in RUNS if path.stem == OVER_THE_WIRE),
    ],
    ids=lambda value: value if isinstance(value, str) else value.stem,
    indirect=["ros"],
)
def test_replayed_poses_are_identical(path, ros):
    head, *records = map(json.loads, path.read_text().splitlines())
    start = {key: head["start"][key] for key in ("x", "y", "theta")}
    ros.call("/turtle1/teleport_absolute", "turtlesim/srv/TeleportAbsolute", **start)
    poses = ros.hear("/turtle1/pose", "turtlesim/msg/Pose")
    waiting, expected = [], []
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
            ros.command(command["linear_x"], command["linear_y"], command["angular_z"])
        ros.step()
        expected.append(tuple(record[key] for key in ("x", "y", "theta", "v", "w")))
    assert not waiting
    assert len(expected) >= 100
    ros.until(lambda: len(poses) == len(expected))
    seen = [(p.x, p.y, p.theta, p.linear_velocity, p.angular_velocity) for p in poses]
    assert seen == expected
