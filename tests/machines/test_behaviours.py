"""The behaviours that most robots need: what is proved of them, and what they do."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, inf, nan, sin
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import llfsm.machines
from llfsm.machines import behaviours
from llfsm.machines.behaviours import (
    AUTONOMY,
    BATTERY,
    BOOLS,
    BUTTON,
    CMD_VEL,
    DOCK,
    DOCK_FAILED,
    DOCKED,
    EMERGENCY,
    INPUT,
    LEVEL,
    POSE,
    RANGE,
    RESET,
    REST,
    SCAN,
    STUCK,
    TELEOP,
    VELOCITY,
    BatteryWatch,
    CollisionStop,
    CommandArbiter,
    DockAndCharge,
    EmergencyStop,
    Level,
    Patrol,
    Ramp,
    ScanCollisionStop,
    SpeedLimit,
    StuckWatch,
)
from llfsm.machines.properties import behaviours as proved
from llfsm.runtime import Arrangement, ExecutionError, Machine, ManualClock
from llfsm.runtime.engine.machine import MachineType
from llfsm.runtime.verification import Property, explore
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.geometry_msgs import (
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Twist,
    Vector3,
)
from llfsm.whiteboard.messages.sensor_msgs import BatteryState, LaserScan, Range
from llfsm.whiteboard.messages.std_msgs import Bool

PERIOD_MS = 100
STUDIES: Mapping[tuple[Any, ...], list[Property]] = {
    proved.COMMANDS: [
        proved.pressed_stops, proved.held_until_reset, proved.ready_before_released,
        proved.emergency_stops, proved.person_comes_first, proved.passes,
    ],
    proved.COLLISION: [
        proved.near_stops, proved.near_slows, proved.back_stays_free, proved.full_speed,
    ],
    proved.LIMIT: [proved.limit_is_kept],
    proved.RAMP: [proved.ramp_is_kept, proved.top_speed_is_reached],
    proved.WATCHES: [
        proved.critical_is_not_good, proved.level_keeps_its_distance, proved.silence_is_noticed,
    ],
    proved.STUCK_WATCH: [proved.needs_a_command, proved.stuck_after_a_wait],
    proved.PATROL: [
        proved.blind_rests, proved.turns_on_the_spot, proved.waypoints_in_order,
        proved.each_waypoint_is_reached,
    ],
    proved.DOCKING: [
        proved.a_low_robot_docks, proved.leaves_charged, proved.charging_is_reached,
    ],
}  # fmt: skip


@pytest.mark.parametrize("machines", STUDIES, ids=lambda machines: str(machines[0].__name__))
def test_the_properties_hold(machines: tuple[Any, ...]) -> None:
    space = explore(
        machines,
        properties=STUDIES[machines],
        period_ms=PERIOD_MS,
        sensors=proved.WORLDS[machines],
    )
    assert [v.property for v in space.verdicts if v.holds is not True] == []
    assert not any(verdict.vacuous for verdict in space.verdicts)


def test_every_property_is_proved() -> None:
    listed = [each for each in vars(proved).values() if isinstance(each, Property)]
    assert sorted(map(str, listed)) == sorted(str(e) for found in STUDIES.values() for e in found)


def test_every_behaviour_is_found_by_its_name() -> None:
    machines = [n for n in behaviours.__all__ if isinstance(vars(behaviours)[n], MachineType)]
    assert set(machines) <= set(llfsm.machines.__all__)


class Simulated:
    """Machines in simulated time, a turn every 100 ms."""

    def __init__(self, *machines: type[Machine] | Machine) -> None:
        self.clock = ManualClock()
        self.board = LocalBoard(now_ns=self.clock.now_ns)
        self.arrangement = Arrangement(machines, whiteboard=self.board, clock=self.clock)

    def go_on(self, ms: float = PERIOD_MS, **messages: Any) -> None:
        """Let time pass, with messages that arrive in every turn, by the names in SLOTS."""
        for _ in range(round(ms / PERIOD_MS)):
            for name, message in messages.items():
                self.board.add_message(SLOTS[name], message)
            self.arrangement.round()
            self.clock.advance(ms=PERIOD_MS)

    @property
    def ahead(self) -> float:
        command = self.board.get_message(CMD_VEL)
        return 0.0 if command is None else command.linear.x


SLOTS: dict[str, Any] = {
    "button": BUTTON, "reset": RESET, "emergency": EMERGENCY, "teleop": TELEOP,
    "autonomy": AUTONOMY, "input": INPUT, "range": RANGE, "scan": SCAN, "battery": BATTERY,
    "velocity": VELOCITY, "cmd_vel": CMD_VEL, "pose": POSE, "docked": DOCKED,
}  # fmt: skip


def ahead(speed: float) -> Twist:
    return Twist(Vector3(x=speed))


def test_an_emergency_stop_is_held_until_it_is_reset() -> None:
    robot, (off, on) = Simulated(EmergencyStop, CommandArbiter), BOOLS
    robot.go_on(1000, button=off, teleop=ahead(1))
    assert robot.ahead == 0  # nobody has reset it yet
    robot.go_on(500, button=off, reset=on, teleop=ahead(1))
    assert robot.ahead == 1
    robot.go_on(button=on, reset=on, teleop=ahead(1))
    assert robot.ahead == 0
    robot.go_on(1000, button=off, reset=on, teleop=ahead(1))
    assert robot.ahead == 0  # the key was pressed all the time
    robot.go_on(300, button=off, reset=off)
    robot.go_on(500, button=off, reset=on, teleop=ahead(1))
    assert robot.ahead == 1
    robot.go_on(1500, teleop=ahead(1))
    assert robot.ahead == 0  # the button is silent


def test_a_person_comes_before_the_plan_and_silence_is_rest() -> None:
    robot = Simulated(CommandArbiter)
    robot.go_on(500, autonomy=ahead(1))
    assert robot.ahead == 0  # no emergency stop has reported
    robot.go_on(500, emergency=Bool(False), autonomy=ahead(1))
    assert robot.ahead == 1
    robot.go_on(500, autonomy=ahead(1), teleop=ahead(-1))
    assert robot.ahead == -1
    robot.go_on(1000, autonomy=ahead(1))
    assert robot.ahead == 1
    robot.go_on(1000)
    assert robot.ahead == 0


@pytest.mark.parametrize(
    ("metres", "speed"), [(0.2, 0), (0.7, 0.3), (2.0, 1.0), (inf, 1.0), (nan, 0)]
)
def test_a_robot_slows_down_and_stops_before_an_obstacle(metres: float, speed: float) -> None:
    robot = Simulated(CollisionStop)
    robot.go_on(1000, input=ahead(1), range=Range(range=metres))
    assert robot.ahead == pytest.approx(speed)
    robot.go_on(input=ahead(-1), range=Range(range=metres))
    robot.go_on(input=ahead(-1), range=Range(range=metres))
    assert robot.ahead == -1
    robot.go_on(1000, input=ahead(1))
    assert robot.ahead == 0  # the sensor is silent


def scan(**metres: float) -> LaserScan:
    """Make a scan of 180 degrees to both sides, with what is ahead, to the left, and behind."""
    ranges = [metres.get("behind", 9.0), 9.0, metres.get("ahead", 9.0), metres.get("left", 9.0)]
    return LaserScan(
        angle_min=-3.14, angle_increment=1.57, range_min=0.1, range_max=10.0, ranges=tuple(ranges)
    )


@pytest.mark.parametrize(
    ("seen", "speed"),
    [
        (scan(ahead=0.3), 0.0),
        (scan(ahead=0.05), 1.0),  # nearer than it can measure: it does not count
        (scan(left=0.3, behind=0.3), 1.0),
        (scan(ahead=0.8), 0.3),
        (LaserScan(), 0.0),
    ],
)
def test_what_a_laser_sees_ahead_counts(seen: LaserScan, speed: float) -> None:
    robot = Simulated(ScanCollisionStop)
    robot.go_on(1000, input=ahead(1), scan=seen)
    assert robot.ahead == pytest.approx(speed)


@given(st.lists(st.floats(-5, 5) | st.just(nan), max_size=20))
def test_a_limit_is_kept_whatever_is_commanded(speeds: list[float]) -> None:
    robot = Simulated(SpeedLimit(linear=0.7))
    for speed in speeds:
        robot.go_on(input=ahead(speed))
        assert robot.ahead == pytest.approx(0 if speed != speed else max(-0.7, min(0.7, speed)))


@given(st.lists(st.floats(-5, 5), max_size=20))
def test_a_ramp_is_kept_and_leads_to_what_is_commanded(speeds: list[float]) -> None:
    robot, before = Simulated(Ramp(linear_step=0.5)), 0.0
    for speed in speeds:
        robot.go_on(input=ahead(speed))
        assert abs(robot.ahead - before) <= 0.5 + 1e-9
        before = robot.ahead
    robot.go_on(3000, input=ahead(2))
    assert robot.ahead == pytest.approx(2)


def test_a_battery_s_noise_does_not_change_its_level() -> None:
    robot, levels = Simulated(BatteryWatch), []
    robot.board[LEVEL].subscribe(lambda sample: levels.append(sample.message.level))
    for part in (0.9, 0.31, 0.29, 0.31, 0.29, 0.33, 0.09, 0.11, 0.09, 0.5, 0.5):
        robot.go_on(300, battery=BatteryState(percentage=part))
    robot.go_on(500, battery=BatteryState(percentage=nan))
    level = robot.board[LEVEL]
    assert level.count == len(
        [Level.UNKNOWN, Level.GOOD, Level.LOW, Level.CRITICAL, Level.LOW, Level.GOOD, Level.UNKNOWN]
    )
    assert level.get().level is Level.UNKNOWN


def test_a_robot_that_does_not_move_is_stuck_after_two_seconds() -> None:
    robot = Simulated(StuckWatch)
    robot.go_on(1900, cmd_vel=ahead(1), velocity=REST)
    assert not robot.board.get_message(STUCK).data
    robot.go_on(500, cmd_vel=ahead(1), velocity=REST)
    assert robot.board.get_message(STUCK).data
    robot.go_on(300, cmd_vel=ahead(1), velocity=ahead(0.5))
    assert not robot.board.get_message(STUCK).data


class Rover:
    """A robot on a plane that does what is commanded."""

    def __init__(self, robot: Simulated) -> None:
        self.robot = robot
        self.x = self.y = self.heading = 0.0
        self.been: list[tuple[float, float]] = []

    def go_on(self, ms: float) -> None:
        for _ in range(round(ms / PERIOD_MS)):
            turned = Quaternion(z=sin(self.heading / 2), w=cos(self.heading / 2))
            self.robot.go_on(pose=PoseStamped(pose=Pose(Point(self.x, self.y), turned)))
            command = self.robot.board.get_message(AUTONOMY)
            step = command.linear.x * PERIOD_MS / 1e3
            self.x += step * cos(self.heading)
            self.y += step * sin(self.heading)
            self.heading += command.angular.z * PERIOD_MS / 1e3
            if self.robot.arrangement.states().get("Patrol") == "AT_WAYPOINT":
                self.been.append((round(self.x, 0), round(self.y, 0)))


def waypoints_of(rover: Rover) -> list[tuple[float, float]]:
    return [at for at, before in zip(rover.been, [None, *rover.been], strict=False) if at != before]


def test_a_patrol_goes_to_each_waypoint_in_order() -> None:
    corners = ((2.0, 0.0), (2.0, 2.0), (-1.0, 1.0))
    robot = Simulated(Patrol(waypoints=corners, rounds=2))
    rover = Rover(robot)
    rover.go_on(120_000)
    assert waypoints_of(rover) == [*corners, *corners]
    assert robot.arrangement.states() == {}  # it is done
    assert robot.board.get_message(AUTONOMY) == REST


def test_a_patrol_without_a_pose_rests_and_goes_on_to_the_same_waypoint() -> None:
    robot = Simulated(Patrol(waypoints=((3.0, 0.0), (0.0, 0.0))))
    rover = Rover(robot)
    rover.go_on(3000)
    assert robot.board.get_message(AUTONOMY).linear.x > 0
    robot.go_on(1000)
    assert robot.board.get_message(AUTONOMY) == REST
    rover.go_on(12_000)
    assert waypoints_of(rover) == [(3, 0)]


def test_a_patrol_without_waypoints_names_how_to_give_them() -> None:
    robot = Simulated(Patrol)
    with pytest.raises(ExecutionError, match=r"no waypoints; give them as in Patrol\(waypoints="):
        robot.go_on(500)


@given(st.lists(st.sampled_from(["suspend", "resume", "restart", None]), max_size=30))
def test_a_patrol_that_does_not_run_leaves_the_robot_at_rest(requests: list[str | None]) -> None:
    robot = Simulated(Patrol(waypoints=((9.0, 0.0),)))
    for request in requests:
        if request is not None:
            getattr(robot.arrangement, request)("Patrol")
        robot.go_on(pose=PoseStamped())
        if robot.arrangement.is_suspended("Patrol"):
            assert robot.board.get_message(AUTONOMY) in (None, REST)
    robot.go_on(500, pose=PoseStamped())
    robot.arrangement.unload("Patrol")
    assert robot.board.get_message(AUTONOMY) in (None, REST)


def test_a_low_robot_stays_at_its_dock_until_it_is_charged() -> None:
    robot, (off, on) = Simulated(BatteryWatch, DockAndCharge), BOOLS
    wanted = lambda: robot.board.get_message(DOCK).data  # noqa: E731
    robot.go_on(1000, battery=BatteryState(percentage=0.5), docked=off)
    assert not wanted()
    robot.go_on(1000, battery=BatteryState(percentage=0.2), docked=off)
    assert wanted()
    robot.go_on(1000, battery=BatteryState(percentage=0.7), docked=on)
    assert wanted()  # it is not low any more, but not full
    robot.go_on(1000, battery=BatteryState(percentage=0.96), docked=on)
    assert not wanted()


def test_a_robot_that_does_not_reach_its_dock_reports_it_until_it_does() -> None:
    robot, (off, on) = Simulated(BatteryWatch, DockAndCharge), BOOLS
    failed = lambda: robot.board.get_message(DOCK_FAILED)  # noqa: E731
    robot.go_on(119_000, battery=BatteryState(percentage=0.2), docked=off)
    assert failed() is None
    robot.go_on(3000, battery=BatteryState(percentage=0.2), docked=off)
    assert failed() == Bool(True)
    assert robot.board.get_message(DOCK) == Bool(True)
    robot.go_on(500, battery=BatteryState(percentage=0.2), docked=on)
    assert failed() == Bool(False)


DRIVERS = [CommandArbiter, SpeedLimit, Ramp, CollisionStop, ScanCollisionStop]


@pytest.mark.parametrize("driver", DRIVERS)
@given(st.lists(st.sampled_from(["suspend", "resume", "restart", None]), max_size=30))
def test_a_driver_that_does_not_run_leaves_the_robot_at_rest(
    driver: type[Machine], requests: list[str | None]
) -> None:
    robot = Simulated(driver)
    name = driver.__name__
    everything = {
        "input": ahead(1), "teleop": ahead(1), "emergency": Bool(False),
        "range": Range(range=9.0), "scan": scan(),
    }  # fmt: skip
    for request in requests:
        if request is not None:
            getattr(robot.arrangement, request)(name)
        robot.go_on(**everything)
        if robot.arrangement.is_suspended(name):
            assert robot.ahead == 0
    robot.arrangement.unload(name)
    assert robot.ahead == 0
