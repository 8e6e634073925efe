"""Check llfsm against a real ROS 2, whose environment is sourced, and print a table.

    python tests/ros/with_ros.py [--domain N] [--transport rclpy|zenoh] [ROW...]

Each row starts what it needs, asks the commands of ROS (`ros2 ...`), and ends it. The row `launch`
needs llfsm in a sourced colcon workspace. With `--transport zenoh`, ROS has to use rmw_zenoh_cpp
(`RMW_IMPLEMENTATION`), and a router must run. The exit status is 1 unless every row holds, and 2 if
no ROS is sourced.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, Protocol

from llfsm.whiteboard import BoardNotFoundError
from llfsm.whiteboard.board_files import remove_board

__all__ = ["ROWS", "Outcome", "RowError", "World", "main", "table", "try_row"]

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 30.0
_POLL_S = 0.2
_MORE_S = 0.5  # that may be noise in the time that a command of ROS takes
_TIMES = 3


class RowError(Exception):
    """A row does not hold; the text is what was seen."""


class Running(Protocol):
    """A process in the background."""

    def output(self) -> str:
        """Return what it has printed by now."""

    def interrupt(self, times: int = 1) -> int:
        """Send it and its children SIGINT so often; wait for its end; return its status."""


class World(Protocol):
    """Where rows run commands."""

    folder: Path

    def ros2(self, *arguments: str) -> str:
        """Run a command of ROS; return what it prints."""

    def start(self, *command: str) -> Running:
        """Start `llfsm ...` or `ros2 ...`, which is ended after the row."""

    def ros_options(self) -> tuple[str, ...]:
        """Return the options of llfsm that name the transport and the domain."""

    def now(self) -> float:
        """Return the time in seconds."""

    def sleep(self, seconds: float) -> None:
        """Let time pass."""


class Shell:
    """Processes of this host, in one domain, for one row."""

    def __init__(self, folder: Path, domain: int, transport: str) -> None:
        self.folder = folder
        self._transport, self._domain = transport, domain
        self._board = f"with-ros-{os.getpid()}"
        self._environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "PYTHONUNBUFFERED": "1",
            "WHITEBOARD_NAME": self._board,
            "QT_QPA_PLATFORM": os.environ.get("QT_QPA_PLATFORM", "offscreen"),  # for turtlesim_node
        }
        self._started: list[_Process] = []

    def ros2(self, *arguments: str) -> str:
        done = subprocess.run(
            ["ros2", *arguments],
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            timeout=4 * PATIENCE_S,
            check=False,
        )
        return done.stdout

    def start(self, *command: str) -> Running:
        name, *arguments = command
        whole = [sys.executable, "-m", "llfsm.cli"] if name == "llfsm" else [name]
        file = self.folder / f"{len(self._started)}.log"
        process = _Process([*whole, *arguments], self._environment, file)
        self._started.append(process)
        return process

    def ros_options(self) -> tuple[str, ...]:
        return "--transport", self._transport, "--domain", str(self._domain)

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    def close(self) -> None:
        """End what is still running."""
        for process in reversed(self._started):
            process.close()
        with suppress(BoardNotFoundError):
            remove_board(self._board)


class _Process:
    def __init__(self, command: list[str], environment: dict[str, str], file: Path) -> None:
        self._file = file
        with file.open("wb") as log:
            self._process = subprocess.Popen(
                command,
                env=environment,
                stdout=log,
                stderr=log,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )

    def output(self) -> str:
        return self._file.read_text(errors="replace")

    def interrupt(self, times: int = 1) -> int:
        for _ in range(times):
            if self._process.poll() is None:
                os.killpg(self._process.pid, signal.SIGINT)
                time.sleep(0.1)  # two at once would count as one
        return self._process.wait(PATIENCE_S)

    def close(self) -> None:
        try:
            self.interrupt()
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()


def wait_for(world: World, look: Callable[[], str], *texts: str) -> str:
    """Wait until what `look` returns has all the texts; return it."""
    until = world.now() + PATIENCE_S
    while True:
        seen = look()
        missing = [text for text in texts if text not in seen]
        if not missing:
            return seen
        if world.now() >= until:
            raise RowError(f"no {missing[0]!r} in: {' '.join(seen.split())[-200:]}")
        world.sleep(_POLL_S)


def _nodes(world: World, *names: str) -> None:
    wait_for(world, lambda: world.ros2("node", "list"), *names)


def _parameter_list(world: World) -> str:
    def fastest() -> tuple[float, str]:
        taken = []
        for _ in range(_TIMES):
            begun = world.now()
            seen = world.ros2("param", "list")
            taken.append((world.now() - begun, seen))
        return min(taken)

    without, _ = fastest()
    world.start("llfsm", "turtlesim", "--ros", *world.ros_options())
    relay = ("--to-ros", "out:std_msgs/msg/String")
    world.start("llfsm", "bridge", "ros2", *relay, *world.ros_options())
    _nodes(world, "/turtlesim", "/llfsm_bridge")
    beside, seen = fastest()
    figures = f"{without:.1f} s without our nodes, {beside:.1f} s with two"
    if "background_r" not in seen or "relays./out.rate" not in seen:
        raise RowError(f"parameters are missing; {figures}")
    if beside > without + _MORE_S:
        raise RowError(figures)
    return figures


def _action(world: World) -> str:
    world.start("llfsm", "turtlesim", "--ros", *world.ros_options())
    _nodes(world, "/turtlesim")
    goal = ("/turtle1/rotate_absolute", "turtlesim/action/RotateAbsolute", "{theta: 0.5}")
    seen = world.ros2("action", "send_goal", *goal)
    if "SUCCEEDED" not in seen:
        raise RowError(" ".join(seen.split())[-200:])
    return "a goal succeeded"


def _clock(world: World) -> str:
    world.start("llfsm", "turtlesim", "--ros", "--clock", *world.ros_options())
    _nodes(world, "/turtlesim")
    seen = world.ros2("topic", "echo", "--once", "/clock", "rosgraph_msgs/msg/Clock")
    if "nanosec:" not in seen:
        raise RowError(" ".join(seen.split())[-200:])
    run = world.start("llfsm", "run", "--ros-time", "RosPingPong", "-v", *world.ros_options())
    wait_for(world, run.output, "RosPingPong")
    return "it is published, and machines run by it"


def _at_loss(world: World) -> str:
    config = world.folder / "bridge.toml"
    config.write_text(
        '[[relay]]\nslot = "cmd"\ntype = "geometry_msgs/msg/Twist"\ndirection = "to_ros"\n'
        "at_loss = {linear = {x = -1.0}}\n"
    )
    world.start("llfsm", "bridge", "ros2", "--config", str(config), *world.ros_options())
    _nodes(world, "/llfsm_bridge")
    echo = world.start("ros2", "topic", "echo", "/cmd", "geometry_msgs/msg/Twist")
    slot = ("cmd", '{"linear": {"x": 1.0}}')

    def post_and_end() -> str:  # until the subscription is there
        world.start("llfsm", "whiteboard", "add", *slot).interrupt(0)
        return echo.output()

    wait_for(world, post_and_end, "x: -1.0")
    return "the message for a lost process came"


def _lifecycle(world: World) -> str:
    options = ("--ros", "--lifecycle", "--node", "wheels", *world.ros_options())
    world.start("llfsm", "run", "RosBlindTurttleBot", *options)
    _nodes(world, "/wheels")
    for transition, state in (
        ("configure", "inactive"),
        ("activate", "active"),
        ("deactivate", "inactive"),
        ("cleanup", "unconfigured"),
        ("shutdown", "finalized"),
    ):
        world.ros2("lifecycle", "set", "/wheels", transition)
        wait_for(world, lambda: f" {world.ros2('lifecycle', 'get', '/wheels')}", f" {state}")
    return "five transitions"


def _launch(world: World) -> str:
    statuses = []
    for times in (1, 2):
        launched = world.start("ros2", "launch", str(ROOT / "launch/wall.launch.py"))
        wait_for(world, launched.output, "STRAIGHT")
        statuses.append(launched.interrupt(times))
        died = [line for line in launched.output().splitlines() if "process has died" in line]
        died = [line for line in died if "[llfsm-" in line]  # turtlesim_node may, of the second
        if died:
            raise RowError(f"after {times} SIGINT: {died[0][:200]}")
    if statuses[0] != statuses[1]:
        raise RowError("one SIGINT ends with {}, two with {}".format(*statuses))
    return f"one SIGINT and two end with {statuses[0]}"


def _bag(world: World) -> str:
    file = world.folder / "drive.mcap"
    world.start("llfsm", "turtlesim")
    record = world.start("llfsm", "record", "--cdr", "-o", str(file), "--max-time", "3")
    record.interrupt(0)
    about = world.ros2("bag", "info", str(file))
    for text in ("/turtle1/pose", "turtlesim/msg/Pose"):
        if text not in about:
            raise RowError(f"no {text!r} in ros2 bag info")
    echo = world.start("ros2", "topic", "echo", "/turtle1/pose", "turtlesim/msg/Pose")
    world.start("ros2", "bag", "play", "--loop", str(file))
    wait_for(world, echo.output, "theta:")
    return "ros2 bag reads and plays it"


ROWS: dict[str, Callable[[World], str]] = {
    "param list": _parameter_list,
    "actions": _action,
    "clock": _clock,
    "at_loss": _at_loss,
    "lifecycle": _lifecycle,
    "launch": _launch,
    "bags": _bag,
}


class Outcome(NamedTuple):
    """What came of a row."""

    row: str
    holds: bool
    seen: str


def try_row(row: str, world: World) -> Outcome:
    """Try a row in a world of its own."""
    try:
        return Outcome(row, True, ROWS[row](world))
    except (RowError, OSError, subprocess.TimeoutExpired) as error:
        return Outcome(row, False, str(error))


def table(outcomes: list[Outcome]) -> str:
    """Return the rows as a table in Markdown."""
    lines = [f"| {row} | {'yes' if holds else 'NO'} | {seen} |" for row, holds, seen in outcomes]
    return "\n".join(["| row | holds | seen |", "|---|---|---|", *lines])


@contextmanager
def shell(domain: int, transport: str) -> Iterator[Shell]:
    """Make a place for one row."""
    with TemporaryDirectory() as folder:
        made = Shell(Path(folder), domain, transport)
        try:
            yield made
        finally:
            made.close()


def main(arguments: list[str] | None = None) -> int:
    """Try rows, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("rows", metavar="ROW", nargs="*", help=", ".join(ROWS))
    parser.add_argument("--domain", type=int, default=98, help="where nobody else is (98)")
    parser.add_argument("--transport", choices=["rclpy", "zenoh"], default="rclpy")
    options = parser.parse_args(arguments)
    unknown = [row for row in options.rows if row not in ROWS]
    if unknown:
        parser.error(f"no row {unknown[0]!r}; there are: {', '.join(ROWS)}")
    if shutil.which("ros2") is None:
        print("no ros2 is found: source a ROS environment first", file=sys.stderr)
        return 2
    outcomes = []
    for row in options.rows or ROWS:
        with shell(options.domain, options.transport) as world:
            outcomes.append(try_row(row, world))
        print(f"{row}: {outcomes[-1].seen}", file=sys.stderr, flush=True)
    with shell(options.domain, options.transport) as world:
        world.ros2("daemon", "stop")  # which the first command of ROS has started in this domain
    print(table(outcomes))
    return 0 if all(outcome.holds for outcome in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
