"""A node's time is the host's, or that of /clock, on every transport; machines can run by it."""

from __future__ import annotations

import signal
import threading
import time
from pathlib import Path

import pytest

from calling import call
from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.node_parameters import NodeParameters
from llfsm.bridges.ros2.node_time import CLOCK_QOS, CLOCK_TYPE, from_ns, to_ns
from llfsm.bridges.ros2.qos import Qos, ReliabilityPolicy
from llfsm.bridges.ros2.standard_node import equip
from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport
from llfsm.cli.run import world as ros_world
from llfsm.runtime import SimulatedClock
from own_boards import own_board
from waiting import PATIENCE_S, wait_for

MACHINE = """
from llfsm.runtime import Machine, State

class Timer(Machine):
    "Accept after an hour."
    waiting = State()
    done = State()
    waiting.to(done, after=3600)
"""


def now(do):
    do()


POLICIES = {
    f"qos_overrides./clock.subscription.{policy}"
    for policy in ("depth", "durability", "history", "reliability")
}


def clock_ends(transport, role):
    return [end for end in transport.graph().ends("/clock", role) if end.node == "/robot"]


@pytest.fixture
def player(world, types):
    """Return what publishes a time on /clock."""
    of = types.message(CLOCK_TYPE)
    publisher = world.open().node("player").publisher("/clock", of, CLOCK_QOS)
    return lambda ns: publisher.publish(of.message(clock=from_ns(ns)))


def test_use_sim_time_follows_the_clock_and_leaves_it(world, types, player):
    ours = world.open()
    parameters = NodeParameters()
    parameters.override({"use_sim_time": True})
    times = equip(ours.node("robot"), types, parameters, now).time
    assert times.now_ns() == 0
    assert parameters.declared.keys() >= POLICIES
    wait_for(lambda: times.now_ns() == 7_000_000_005, between=lambda: player(7_000_000_005))
    wait_for(lambda: times.now_ns() == 3, between=lambda: player(3))  # back, too
    (end,) = clock_ends(ours, Role.SUBSCRIPTION)
    assert end.type_name == "rosgraph_msgs/msg/Clock"
    assert end.qos is not None
    assert end.qos.reliability is ReliabilityPolicy.BEST_EFFORT

    before = time.time_ns()
    parameters.assign("use_sim_time", False)
    assert times.now_ns() >= before
    assert ours.wait_graph(lambda _: not clock_ends(ours, Role.SUBSCRIPTION), PATIENCE_S)
    parameters.assign("use_sim_time", True)
    wait_for(lambda: times.now_ns() == 9, between=lambda: player(9))


def test_events_of_parameters_have_its_stamp(world, types, player, seen):
    events = seen()
    event = types.message("rcl_interfaces/msg/ParameterEvent")
    other = world.open()
    parameters = NodeParameters()
    parameters.override({"use_sim_time": True, "qos_overrides./clock.subscription.depth": 3})
    ours = world.open()
    node = ours.node("robot")
    times = equip(node, types, parameters, now).time
    wait_for(lambda: times.now_ns() == 5_000_000_000, between=lambda: player(5_000_000_000))

    def arrived(arrival):
        message = arrival.decode()
        if message.node == "/robot":  # rclpy publishes some of the others
            events(message)

    other.node("tool").subscription("/parameter_events", event, arrived, Qos(depth=1000))
    of = types.service("rcl_interfaces/srv/SetParameters")
    held = types.message("rcl_interfaces/msg/ParameterValue").message(type=1, bool_value=True)
    named = types.message("rcl_interfaces/msg/Parameter").message(name="use_sim_time", value=held)
    client = other.node("setter").client("/robot/set_parameters", of)
    assert other.wait_graph(lambda _: client.ready, PATIENCE_S)
    request = of.request.message(parameters=(named,))
    events.repeat(lambda: client.call(request, timeout=PATIENCE_S).result(PATIENCE_S))
    assert to_ns(events[0].stamp) == 5_000_000_000


def test_a_node_that_lives_by_the_clock_cannot_leave_it(world, types, player):
    parameters, received = NodeParameters(), []
    equip(world.open().node("robot"), types, parameters, now, received.append)
    wait_for(lambda: received, between=lambda: player(4))
    assert received[0] == 4
    assert "read-only" in str(parameters.refusal(("use_sim_time", False)))


@pytest.mark.parametrize(
    ("option", "ros_args"),
    [
        (["--ros-time"], []),
        (["--ros"], ["--ros-args", "-r", "__ns:=/a", "-p", "use_sim_time:=true"]),
    ],
)
def test_machines_run_by_the_clock_as_it_jumps_and_run_again(
    tmp_path: Path, types, router, option, ros_args
):
    """An hour passes in forty messages; without them, the same from the recording."""
    (tmp_path / "timer.py").write_text(MACHINE)
    over = threading.Event()

    def play(publisher) -> None:
        ns = 1_700_000_000 * 10**9
        while not over.wait(0.005):
            publisher.publish(of.message(clock=from_ns(ns)))
            ns += 90 * 10**9

    of = types.message(CLOCK_TYPE)
    with ZenohTransport(88, router=[router]) as transport, own_board() as board:
        thread = threading.Thread(
            target=play, args=(transport.node("player").publisher("/clock", of, CLOCK_QOS),)
        )
        thread.start()
        try:
            done = call(
                *("run", "timer.py:Timer", "-v", "-b", board, "--remove-board", *option),
                *("--transport", "zenoh", "--router", router, "--domain", "88"),
                *("--record", "run.mcap", *ros_args),
                cwd=tmp_path,
            )
        finally:
            over.set()
            thread.join()
    assert done.returncode == 0, done.stderr
    assert "Timer                - done" in done.stderr
    again = call("rerun", "run.mcap", "timer.py:Timer", cwd=tmp_path)
    assert again.returncode == 0, again.stdout + again.stderr


def test_ctrl_c_ends_a_run_that_waits_for_a_time(tmp_path: Path, router, monkeypatch):
    class Interrupted(SimulatedClock):
        waits = 0

        def wait_set(self, timeout_s):
            self.waits += 1
            if self.waits == 2:  # it has reported that it waits
                signal.raise_signal(signal.SIGINT)
            return super().wait_set(0)

    monkeypatch.setattr(ros_world, "SimulatedClock", Interrupted)
    done = call(
        *("run", "RosPingPong", "--ros-time", "--transport", "zenoh", "--router", router),
        *("--domain", "87"),
        cwd=tmp_path,
    )
    assert done.returncode == 0


def test_a_run_that_starts_again_has_no_ros_time(tmp_path: Path) -> None:
    done = call("run", "RosPingPong", "-n", "--ros-time", cwd=tmp_path)
    assert done.returncode == 2
    assert "-n" in done.stderr
