"""Daemons fetch the slots that processes beside them read, over Zenoh, while these run."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import MIRROR
from llfsm.whiteboard.mirror.batches import VERSION
from llfsm.whiteboard.mirror.groups import group_of
from waiting import wait_for

from .conftest import NAME, Host, MakeHost, Number, number_slot, plain_session

POSE, MAP, IMAGE = (number_slot(name) for name in ("robot/pose", "maps/map", "camera/image"))

READER = """
import sys
import time
from llfsm.whiteboard import Slot, Whiteboard
board = Whiteboard(sys.argv[1], directory=sys.argv[2])
slot = board.find("robot/pose")
board.get_message(slot)
print("reads", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def lazy(tmp_path: Path) -> str:
    config = tmp_path / "lazy.toml"
    config.write_text("eager = false\n")
    return str(config)


@contextmanager
def reader(host: Host) -> Iterator[subprocess.Popen[str]]:
    """A process beside a daemon that reads one slot."""
    with subprocess.Popen(
        [sys.executable, "-c", READER, NAME, str(host.directory)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline() == "reads\n"
        yield process


def test_a_host_gets_what_is_read_on_it_and_nothing_else(make_host: MakeHost, lazy: str) -> None:
    robot, laptop = make_host("robot"), make_host("laptop")
    robot.start("--config", lazy)
    laptop.start("--config", lazy, connect=[robot])
    for slot in (POSE, MAP, IMAGE):
        robot.add(1, slot)
    wait_for(lambda: laptop.get(POSE) == 1)
    robot.add(2, IMAGE)
    for value in range(2, 6):
        robot.add(value, POSE)
        wait_for(lambda value=value: laptop.get(POSE) == value)
    wait_for(lambda: laptop.get(MAP) == 1)  # first read long after it was added
    laptop.add(9, POSE)  # nobody reads it there, until
    wait_for(lambda: robot.get(POSE) == 9)
    names = {slot.name for slot in laptop.board.slots() if not slot.name.startswith("llfsm/")}
    assert names == {POSE.name, MAP.name}
    wait_for(lambda: [len(host.status()["peers"]) for host in (robot, laptop)] == [1, 1])


def test_an_eager_host_gets_all_and_a_connected_process_too(make_host: MakeHost, lazy: str) -> None:
    robot, laptop = make_host("robot"), make_host("laptop")
    robot.start("--config", lazy)
    laptop.start(connect=[robot])
    robot.add(1, POSE)
    wait_for(lambda: {slot.name for slot in laptop.board.slots()} >= {POSE.name})
    with Whiteboard.connect(robot.endpoint, NAME) as board:
        assert board.get_message(POSE) == Number(1)
        robot.add(2, MAP)
        wait_for(lambda: MAP.name in {slot.name for slot in board.slots()})


def losses(host: Host) -> int:
    """Count the messages of another host that were lost on their way."""
    status = host.board[MIRROR]
    count = status.count
    wait_for(lambda: status.count > count, "a status")
    (peer,) = host.status()["peers"]
    return int(peer["lost"])


def test_hosts_with_many_folders_agree(make_host: MakeHost) -> None:
    """More than are offered, and asked for, at a time; and what changes in all is not too much."""
    robot, laptop = make_host("robot"), make_host("laptop")
    slots = [number_slot(f"folder{number}/x") for number in range(150)]
    for slot in slots:
        robot.add(1, slot)
    robot.start()
    laptop.start(connect=[robot])
    names = {slot.name for slot in slots}
    wait_for(lambda: {slot.name for slot in laptop.board.slots()} >= names)
    wait_for(lambda: all(laptop.get(slot) == 1 for slot in slots))
    before = losses(laptop)
    for value in range(2, 6):
        for slot in slots:
            robot.add(value, slot)
        wait_for(lambda value=value: all(laptop.get(slot) == value for slot in slots))
    assert losses(laptop) == before


def test_queries_under_any_key_leave_the_others_alone(make_host: MakeHost, lazy: str) -> None:
    robot, laptop = make_host("robot"), make_host("laptop")
    robot.add(1, POSE)
    robot.start("--config", lazy)
    with plain_session(robot) as session:
        root = f"llfsm/{VERSION}/{NAME}/state"
        for key in ("llfsm/**", f"{root}/**", f"{root}/*/*/*/*/*", f"{root}/-/*/all/x/y"):
            for _ in session.get(key, payload=b"nonsense", timeout=1.0):
                pass
    laptop.start("--config", lazy, connect=[robot])
    wait_for(lambda: laptop.get(POSE) == 1)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_reader_that_dies_leaves_no_interest_behind(
    make_host: MakeHost, lazy: str, number: signal.Signals
) -> None:
    """As its daemon's subscriptions show."""
    laptop = make_host("laptop")
    laptop.add(1, POSE)
    laptop.start("--config", lazy)
    key = f"llfsm/{VERSION}/{NAME}/slots/-/{{}}/batch"
    with plain_session(laptop) as session:
        pose = session.declare_publisher(key.format(group_of(POSE.name)))
        other = session.declare_publisher(key.format(group_of(MAP.name)))
        for _ in range(2):
            with reader(laptop) as process:
                wait_for(lambda: pose.matching_status.matching)
                process.send_signal(number)
            wait_for(lambda: not pose.matching_status.matching)
        for _ in range(1000):
            laptop.board.publisher(POSE).get()
        laptop.get(MAP)
        gc.collect()
        wait_for(lambda: other.matching_status.matching)
        wait_for(lambda: not pose.matching_status.matching)


def test_a_daemon_that_is_killed_and_started_again_knows_who_reads(
    make_host: MakeHost, lazy: str
) -> None:
    robot, laptop = make_host("robot"), make_host("laptop")
    robot.start("--config", lazy)
    laptop.start("--config", lazy, connect=[robot])
    robot.add(1, POSE)
    wait_for(lambda: laptop.get(POSE) == 1)
    for value, host in enumerate((robot, laptop), 2):
        host.end(signal.SIGKILL)
        robot.add(value, POSE)
        host.start("--config", lazy, connect=[laptop if host is robot else robot])
        wait_for(lambda value=value: laptop.board.get_message(POSE) == Number(value))


def test_what_nobody_reads_costs_a_daemon_little_however_often_it_is_added(
    make_host: MakeHost,
) -> None:
    """It looks at most once in five milliseconds; else it is as busy as who adds."""
    robot = make_host("robot")
    robot.start()
    assert robot.process is not None
    process = Path(f"/proc/{robot.process.pid}/stat")

    def cpu_s() -> float:
        fields = process.read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    robot.add(0, POSE)
    slot = robot.board[POSE]
    begun, before = time.monotonic(), cpu_s()
    while (took_s := time.monotonic() - begun) < 0.7:
        slot.add(Number(1))
    assert cpu_s() - before < took_s / 2
