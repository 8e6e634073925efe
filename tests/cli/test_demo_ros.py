"""`llfsm demo --ros`: whoever dies starts again, and the turtle goes on; all end together."""

from __future__ import annotations

import importlib.util
import itertools
import os
import signal
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from llfsm.cli.demo.ros_graph import RosGraph
from llfsm.cli.options import BoardPlace
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.turtlesim import Pose
from waiting import PATIENCE_S, wait_for

from .conftest import Llfsm, alive, children, exists
from .conftest import wait_for_line as line_with

CMD_VEL = Slot("turtle1/cmd_vel", Twist)
POSE = Slot("turtle1/pose", Pose)
COMMANDS = ("router", "turtlesim", "bridge", "run")
_DOMAINS = itertools.count(171)


@pytest.fixture
def graph() -> tuple[str, ...]:
    """Return options for a graph that nobody else is on, without a router so far."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    return ("--transport", "zenoh", "--domain", str(next(_DOMAINS)), "--router", endpoint)


@pytest.fixture
def start(llfsm: Llfsm, board: str, graph: tuple[str, ...]) -> Callable[..., Demo]:
    def start(*options: str) -> Demo:
        limit = ("--seconds", str(2 * PATIENCE_S))  # lest a test wait for a line for ever
        demo = llfsm.start("demo", "wall", "--ros", *graph, "-b", board, *limit, *options)
        line_with(demo, "turtle1 at")
        return demo

    return start


Demo = subprocess.Popen[str]


def drives_on(board: str) -> bool:
    """Wait until the machine has given a command, and the turtle has obeyed one since."""
    with Whiteboard(board, create=False) as wb:
        command, pose = wb[CMD_VEL], wb[POSE]
        sample = command.wait(after=command.count, timeout=PATIENCE_S)
        while sample is not None and not sample.message.linear.x:
            sample = command.wait(after=sample.count, timeout=PATIENCE_S)
        moving = pose.wait(after=pose.count, timeout=PATIENCE_S)
        while moving is not None and not moving.message.linear_velocity:
            moving = pose.wait(after=moving.count, timeout=PATIENCE_S)
        return sample is not None and moving is not None


def assert_nothing_left(board: str, pids: list[int]) -> None:
    wait_for(lambda: not any(map(alive, pids)), f"an end of {pids}")
    assert not exists(board)


def restarted(demo: Demo, command: str, before: int) -> Callable[[], bool]:
    return lambda: children(demo.pid).get(command, before) != before


# Five seconds of a processor, for twelve processes that start: each of them is also killed by the
# tests of what keeps them running, test_demo_processes.py, and the bridge by the next one here.
@pytest.mark.soak
def test_whoever_is_killed_is_reported_and_started_again_and_the_turtle_goes_on(
    start: Callable[..., Demo], board: str
) -> None:
    demo = start("--picture", "path.svg")
    names = dict(zip(COMMANDS, ("router", "simulator", "bridge", "machine"), strict=True))
    assert set(children(demo.pid)) == set(COMMANDS)
    for command, name in names.items():
        pid = children(demo.pid)[command]
        os.kill(pid, signal.SIGKILL)
        line_with(demo, f"the {name} was killed by SIGKILL; it starts again")
        wait_for(restarted(demo, command, pid), f"a new {name}")
        assert drives_on(board), f"after the end of the {name}"
    pids = list(children(demo.pid).values())
    assert len(pids) == 4
    demo.send_signal(signal.SIGINT)
    printed = demo.stdout.read()
    assert demo.wait() == 0, printed
    assert "the turtle's path: path.svg" in printed
    assert_nothing_left(board, pids)


def test_a_bridge_that_is_told_to_end_takes_the_board_with_it_and_all_is_made_again(
    start: Callable[..., Demo], board: str
) -> None:
    demo = start()
    before = children(demo.pid)
    os.kill(before["bridge"], signal.SIGTERM)
    line_with(demo, " ended with ")  # the bridge, or the machine whose board is gone
    wait_for(restarted(demo, "bridge", before["bridge"]), "a new bridge")
    line_with(demo, "RosWallTurttleBot: INITIAL")  # which is seen on the new board alone
    assert drives_on(board)


def test_a_killed_demo_takes_its_processes_and_its_board_with_it(
    start: Callable[..., Demo], board: str
) -> None:
    demo = start()
    pids = list(children(demo.pid).values())
    demo.kill()
    assert_nothing_left(board, pids)


@pytest.fixture
def others(llfsm: Llfsm, graph: tuple[str, ...]) -> None:
    """Start a router and a turtlesim of somebody else."""
    router = llfsm.start("router", "--listen", graph[-1])
    line_with(router, "listening")
    llfsm.start("turtlesim", "--ros", *graph)


@pytest.mark.usefixtures("others")
def test_it_joins_a_graph_that_has_a_router_and_a_simulator(
    start: Callable[..., Demo], board: str, tmp_path: Path
) -> None:
    demo = start("--no-simulator")
    pids = children(demo.pid)
    assert set(pids) == {"bridge", "run"}
    assert drives_on(board)
    demo.send_signal(signal.SIGINT)
    printed = demo.stdout.read()
    assert demo.wait() == 0, printed
    assert_nothing_left(board, list(pids.values()))
    assert not list(tmp_path.iterdir())  # nobody here could have drawn the path


@pytest.mark.parametrize(
    ("options", "status", "printed"),
    [
        (["--domain", "3"], 2, "--ros is needed for --domain"),
        (["--transport", "auto"], 2, "--ros is needed for --transport"),
        (["--router", "tcp/localhost:1"], 2, "--ros is needed for --router"),
        (["--no-simulator"], 2, "--ros is needed for --no-simulator"),
        (["--ros", "--no-simulator", "--picture", "x"], 2, "--picture: a simulator draws the path"),
        (["--ros", "--domain", "233"], 2, "233 is not in the range"),
        (["--ros", "--record", "x.mcap"], 2, "--record is not for --ros"),
        (["--ros", "--router", "tcp/127.0.0.1:99999"], 1, "the router ended with 1"),
        (["--ros", "--router", "nonsense"], 1, "'nonsense' is not an endpoint such as"),
    ],
)
def test_what_cannot_be_is_refused(
    llfsm: Llfsm, board: str, options: list[str], status: int, printed: str
) -> None:
    done = llfsm.run("demo", "wall", "-b", board, *options)
    assert (done.returncode, printed in done.stderr) == (status, True), done.stderr
    assert "Traceback" not in done.stderr
    assert not exists(board)


def started(graph: RosGraph) -> list[tuple[str, ...]]:
    """Return the commands of all that would be started where nobody listens so far."""
    commands: list[tuple[str, ...]] = []
    served = iter([False])
    processes = SimpleNamespace(start=lambda _, *words: commands.append(words))
    graph.start_router(processes, lambda _: next(served, True))  # type: ignore[arg-type]
    graph.start_simulator(processes, Path("path"))  # type: ignore[arg-type]
    graph.start_bridge(processes, BoardPlace("b", "/dev/shm"))  # type: ignore[arg-type]
    return commands


@pytest.fixture(params=[None, "rclpy"])
def sourced(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    def find_spec(name: str) -> str | None:
        return request.param if name == "rclpy" else None

    monkeypatch.setattr(importlib.util, "find_spec", find_spec)
    monkeypatch.delenv("RMW_IMPLEMENTATION", raising=False)
    return bool(request.param)


def test_its_own_simulator_is_away_from_other_nodes(
    monkeypatch: pytest.MonkeyPatch, sourced: bool
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    graph = RosGraph()
    assert str(graph) == "ROS domain 99"
    assert graph.environment() == {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    *router, simulator, bridge = started(graph)
    assert router == ([] if sourced else [("router",)])
    for command in (simulator, bridge):
        assert "--transport auto --domain 99" in " ".join(command)


@pytest.mark.usefixtures("sourced")
def test_with_the_simulator_of_others_it_is_where_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    graph = RosGraph(simulator=False)
    assert str(graph) == "ROS domain 7"
    assert graph.environment() == {}
    (bridge,) = started(graph)[-1:]
    assert "--domain" not in bridge
    assert str(graph._replace(domain=5)) == "ROS domain 5"


@pytest.mark.parametrize(
    ("graph", "rmw", "router"),
    [
        (RosGraph("zenoh"), "", ("router",)),
        (RosGraph("rclpy"), "", None),
        (RosGraph("rclpy"), "rmw_zenoh_cpp", ("router",)),
        (RosGraph(router="tcp/[::1]:7"), "", ("router", "--listen", "tcp/[::1]:7")),
        (RosGraph(router="tcp/192.168.1.5:7447"), "", None),
    ],
)
@pytest.mark.usefixtures("sourced")
def test_a_router_is_started_if_the_nodes_need_one_on_this_host(
    monkeypatch: pytest.MonkeyPatch, graph: RosGraph, rmw: str, router: tuple[str, ...] | None
) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", rmw)
    commands = started(graph)
    assert [command for command in commands if command[0] == "router"] == [router][: bool(router)]
