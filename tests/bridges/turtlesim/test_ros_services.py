"""Every recorded service call gets the same answer, log and poses from our node."""

from __future__ import annotations

import re

import pytest

from llfsm.bridges.ros2.errors import CallFailedError
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos
from llfsm.whiteboard.schema import to_plain
from waiting import PATIENCE_S

LINE = re.compile(r"\[(\w+)\] \[[\d.]+\] \[turtlesim\]: (.*)")
TYPES = {
    "spawn": "turtlesim/srv/Spawn",
    "kill": "turtlesim/srv/Kill",
    "clear": "std_srvs/srv/Empty",
    "reset": "std_srvs/srv/Empty",
    "set_pen": "turtlesim/srv/SetPen",
    "teleport_absolute": "turtlesim/srv/TeleportAbsolute",
    "teleport_relative": "turtlesim/srv/TeleportRelative",
}


def call(ros, service, **request):
    return ros.call(service, TYPES[service.rpartition("/")[2]], **request)


def fields(message):
    return {name: getattr(message, name) for name in message.__struct_fields__}


def pose_of(ros, turtle):
    poses = ros.hear(f"/{turtle}/pose", "turtlesim/msg/Pose")
    ros.step()
    ros.until(lambda: poses)
    return fields(poses[-1])


def turtles(ros):
    return sorted(
        end.name.split("/")[1]
        for end in ros.transport.graph().endpoints
        if end.role is Role.PUBLISHER and end.name.endswith("/pose")
    )


def test_recorded_services(ros, recorded, log):
    calls = 0
    for record in recorded("turtlesim_services.json"):
        if record["label"] == "turtlesim_node alive after the illegal name":
            assert not record["alive"]  # ours lives; the recording goes on with a new node
            call(ros, "/reset")
        elif record["label"] == "spawn with an illegal name":
            log.clear()
            before = turtles(ros)
            assert call(ros, record["service"], **record["request"]).name == ""
            ((level, text),) = log
            assert level.name == "ERROR"
            assert "'bad name!'" in text
            ros.step()
            assert turtles(ros) == before
        elif "service" in record:
            log.clear()
            answer = call(ros, record["service"], **record["request"])
            assert fields(answer) == record["response"]
            ros.step(2)
            expected = [LINE.fullmatch(line).groups() for line in record["log"]]
            assert [(level.name, text) for level, text in log] == expected, record["label"]
            calls += 1
        for name, pose in poses_in(record).items():
            assert pose_of(ros, name) == pose, record["label"]
        if isinstance(expected_turtles := record.get("turtles"), list):
            assert turtles(ros) == expected_turtles, record["label"]
    assert calls == 20


def poses_in(record):
    """Return all poses that a record holds, by turtle."""
    turtle1 = record.get("turtle1_pose_after") or record.get("pose")
    return record.get("poses", {}) | ({"turtle1": turtle1} if turtle1 else {})


def test_the_log_is_on_rosout_for_who_comes_later(ros):
    call(ros, "/kill", name="nobody")
    qos = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=100)
    lines = ros.hear("/rosout", "rcl_interfaces/msg/Log", qos)
    ros.until(lambda: len(lines) == 2)
    spawned, killed = lines
    assert (spawned.level, spawned.name) == (20, "turtlesim")
    assert spawned.msg.startswith("Spawning turtle [turtle1] at")
    assert killed.level == type(killed).ERROR == 40
    assert killed.msg == "Tried to kill turtle [nobody], which does not exist"
    assert killed.stamp.sec >= spawned.stamp.sec > 1_600_000_000


def test_what_came_for_a_turtle_that_is_killed_first_has_failed_and_harms_nobody(ros, log, caplog):
    call(ros, "/spawn", name="bob")
    ros.command(x=2.0)
    ros.turtlesim.queue.run_pending()
    kill = ros.ask("/kill", TYPES["kill"], name="bob")
    late = ros.ask("/bob/teleport_absolute", TYPES["teleport_absolute"], x=1.0)
    log.clear()
    ros.step()
    ros.until(late.done)
    with pytest.raises(CallFailedError):
        late.result()
    assert fields(kill.result(PATIENCE_S)) == {}
    assert not log
    assert not caplog.records
    assert pose_of(ros, "turtle1")["linear_velocity"] == 2.0


def test_pen_and_clear_are_seen_by_the_color_sensor(ros):
    colors = ros.hear("/turtle1/color_sensor", "turtlesim/msg/Color")
    call(ros, "/turtle1/set_pen", r=9, g=8, b=7, width=5)
    ros.command(x=1.0)
    ros.step(10)
    call(ros, "/turtle1/teleport_relative", linear=-0.1)
    call(ros, "/turtle1/set_pen", off=1)
    ros.step()
    ros.until(lambda: len(colors) == 11)
    assert to_plain(colors[-1]) == {"r": 9, "g": 8, "b": 7}
    call(ros, "/clear")
    ros.step()
    ros.until(lambda: len(colors) == 12)
    assert to_plain(colors[-1]) == {"r": 255, "g": 255, "b": 255}
