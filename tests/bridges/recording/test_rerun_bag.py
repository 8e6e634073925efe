"""Machines run on the topics of a bag, and what they post is compared with it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap_ros2.writer import Writer

from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.replay import BagScript, BoardReplay
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.ros2.types.definition import bundled
from llfsm.runtime import ManualClock
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.turtlesim import Pose

from .conftest import entries_in

TYPES = TypeLibrary()
POSE = Slot("pose", Pose)
MS = 1_000_000
BEGIN_NS = 1_700_000_000_000_000_000
POSES = (1.0, 2.0, 8.5, 8.5, 9.0, 3.0, 2.0)  # one in 25 ms
BEYOND = 2  # the first beyond the line
BACK = 5

CODE = '''
from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.turtlesim import Pose


def going(x):
    return Twist(linear=Vector3(x=x))


class Guard(Machine):
    """Go on up to a line, and back beyond it."""

    pose = Sensor(Slot("pose", Pose))
    drive = Actuator(Slot("drive", Twist), at_end=going(0.0))
    line: float = 8.0
    speed: float = 1.0

    AHEAD = State()
    BACK = State()

    @AHEAD.on_entry
    def _(self):
        self.drive(going(self.speed))

    @BACK.internal
    def _(self):
        self.drive(going(-self.speed))

    AHEAD.to(BACK, when=lambda m: m.pose is not None and m.pose.x > m.line)
    BACK.to(AHEAD, when=lambda m: m.pose is not None and m.pose.x < m.line)


class Idler(Machine):
    pose = Sensor(Slot("pose", Twist))
    A = State()
    A.to(A, when=lambda m: False)


class Spinner(Machine):
    pose = Sensor(Slot("pose", Pose))
    A = State()
    B = State()
    A.to(B)
    B.to(A)
'''


def moving(x):
    return {"linear": {"x": x, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}


def standing(x):
    return {"x": x, "y": 0.0, "theta": 0.0, "linear_velocity": 0.0, "angular_velocity": 0.0}


def write_bag(path: Path, drives: list[tuple[int, float]], poses=POSES) -> None:
    """Write the poses, and commands after so many milliseconds, as rosbag2 does."""
    sent = [
        (n * 25, "/turtle1/pose", "turtlesim/msg/Pose", standing(x)) for n, x in enumerate(poses)
    ]
    sent += [(ms, "/turtle1/cmd_vel", "geometry_msgs/msg/Twist", moving(x)) for ms, x in drives]
    with path.open("wb") as stream:
        writer = Writer(stream)
        schemas = {}
        for ms, topic, kind, message in sorted(sent, key=lambda each: each[0]):
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(kind, bundled(TYPES.sources(kind)))
            stamp_ns = BEGIN_NS + ms * MS
            writer.write_message(topic, schemas[kind], message, stamp_ns, stamp_ns)
        writer.finish()


DROVE = [(0, 1.0), (BEYOND * 25 + 3, -1.0), (BEYOND * 25 + 30, -1.0), (BACK * 25 + 2, 1.0)]


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    (tmp_path / "guards.py").write_text(CODE)
    (tmp_path / "bridge.toml").write_text(
        '[[relay]]\nslot = "pose"\ntopic = "turtle1/pose"\ntype = "turtlesim/msg/Pose"\n'
        'direction = "from_ros"\n'
        '[[relay]]\nslot = "drive"\ntopic = "turtle1/cmd_vel"\n'
        'type = "geometry_msgs/msg/Twist"\ndirection = "to_ros"\n'
    )
    path = tmp_path / "bag.mcap"
    write_bag(path, DROVE)
    return path


CONFIG = ("--config", "bridge.toml")
GUARD = "guards.py:Guard"


def test_what_machines_post_is_as_in_the_bag(llfsm_here, bag: Path) -> None:
    status, printed = llfsm_here("rerun", bag, GUARD, *CONFIG)
    assert (status, printed.endswith("as recorded: 3 of drive\n")) == (0, True), printed
    rests = 2 * (len(POSES) - 1)  # of 10 ms, between two poses
    assert printed.startswith(
        f"{len(POSES) + rests + 2} rounds, "
    )  # at once after both transitions


@pytest.mark.parametrize(
    ("drives", "number", "recorded", "now"),
    [
        ([(0, 1.0), (53, -2.0)], 2, "after 0.053 s", "after 0.050 s"),
        ([(0, 1.0), (53, -1.0)], 3, "nothing", "after 0.125 s"),
        ([*DROVE, (149, 0.0), (150, 7.0)], 5, "after 0.150 s", "nothing"),
    ],
)
def test_the_first_other_message_is_shown(llfsm_here, bag, drives, number, recorded, now) -> None:
    write_bag(bag, drives)
    status, printed = llfsm_here("rerun", bag, GUARD, *CONFIG)
    assert status == 1
    head, *both = printed.splitlines()
    assert head.endswith(f"message {number} of drive differs:")
    assert both[0].startswith(f"  recorded {recorded}")
    assert both[1].startswith(f"  now      {now}")


def test_slots_are_named_by_the_machines_too_and_a_turn_comes_with_each_message(
    llfsm_here, bag: Path
) -> None:
    named = ("Guard:pose:=turtle1/pose", "Guard:drive:=turtle1/cmd_vel")
    run = bag.with_name("run.mcap")
    status, printed = llfsm_here("rerun", bag, GUARD, *named, "--record", run)
    assert (status, printed.endswith("as recorded: 3 of turtle1/cmd_vel\n")) == (0, True), printed
    recording = Recording(run)
    sensed = [each for each in entries_in(recording) if each["event"] == "Sensed"]
    assert len(sensed) == len(POSES)
    again = llfsm_here("rerun", run, "--trust")
    assert again[0] == 0, again[1]


def test_a_period_is_that_of_the_rounds(llfsm_here, bag: Path) -> None:
    bag.with_name("all.toml").write_text(
        f'period_us = 50000\n[[machine]]\ndefinition = "{GUARD}"\n'
    )
    write_bag(bag, [(0, 1.0), (53, -1.0), (153, 1.0)])
    status, printed = llfsm_here("rerun", bag, "all.toml", *CONFIG)
    assert (status, printed.startswith("4 rounds, ")) == (0, True), printed


def test_a_machine_that_never_rests_does_not_stop_the_time(llfsm_here, bag: Path) -> None:
    status, printed = llfsm_here("rerun", bag, "guards.py:Spinner", *CONFIG)
    assert (status, printed.partition(" ")[0][-2:]) == (0, "00"), printed


def test_what_is_no_topic_is_not_compared(llfsm_here, bag: Path) -> None:
    status, printed = llfsm_here("rerun", bag, GUARD, "Guard:pose:=turtle1/pose")
    assert status == 0
    assert "as recorded: none\n" in printed
    assert "not compared, as they are not topics there: drive" in printed


@pytest.mark.parametrize(
    ("arguments", "status", "what"),
    [
        ((), 2, "name the machines that are to read its topics"),
        ((GUARD,), 1, "the machines read pose, but its topics are"),
        (
            ("guards.py:Idler", *CONFIG),
            1,
            "holds turtlesim/msg/Pose, not our geometry_msgs/msg/Twist",
        ),
        ((GUARD, "--trust"), 2, "is a bag, without events of machines: omit --trust"),
        ((GUARD, "--compare", "posts"), 2, "omit --compare"),
        (("timed.toml",), 2, "Guard has a period of its own"),
        ((GUARD, *CONFIG, "Guard:line=oops"), 2, "oops"),
    ],
)
def test_what_cannot_be_run_is_reported(llfsm_here, bag: Path, arguments, status, what) -> None:
    bag.with_name("timed.toml").write_text(
        f'[[machine]]\ndefinition = "{GUARD}"\nperiod_us = 1000\n'
    )
    found, printed = llfsm_here("rerun", bag, *arguments)
    assert found == status, printed
    assert what in printed


def bag_with_gap(file: Path, gap_ns: int) -> Recording:
    """Write a message at 0, as of a simulated clock that nobody had set, and others later."""
    with file.open("wb") as stream:
        writer = Writer(stream)
        name = "turtlesim/msg/Pose"
        schema = writer.register_msgdef(name, bundled(TYPES.sources(name)))
        zero = {"y": 0.0, "theta": 0.0, "linear_velocity": 0.0, "angular_velocity": 0.0}
        for stamp_ns in (0, *(gap_ns + n * 50 * MS for n in range(5))):
            writer.write_message("/pose", schema, {"x": 1.0, **zero}, stamp_ns, stamp_ns)
        writer.finish()
    return Recording(file)


@pytest.mark.parametrize("gap_ns", [3600 * 1000 * MS, BEGIN_NS])
@pytest.mark.parametrize("period_ms", [None, 500.0])
def test_of_a_long_gap_ten_minutes_are_run(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, gap_ns: int, period_ms: float | None
) -> None:
    recording = bag_with_gap(tmp_path / "bag.mcap", gap_ns)
    script = BagScript(recording, {"pose": POSE}, idle_ms=1000.0, period_ms=period_ms)
    waits_ms = [step.wait_ms for step in script]
    assert 600_000 <= sum(waits_ms) < 602_000
    assert [step.wait_ms for step in script] == waits_ms  # it can be gone through again
    assert sum(bool(step.messages) for step in script) >= 2
    assert "nothing in" in caplog.text
    assert "10 minutes of it are played" in caplog.text


def test_a_replay_waits_for_no_longer_gap(tmp_path: Path) -> None:
    recording, board = bag_with_gap(tmp_path / "bag.mcap", BEGIN_NS), Whiteboard.local()
    clock = ManualClock()
    BoardReplay(recording, board).play(lambda: False, clock=clock)
    assert board[POSE].count == 6
    assert 600 <= clock.now_ns() / 1e9 < 602
