"""Commands that show a fleet, and control its machines. No host is eager: what is shown is read."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from calling import call
from forked import Forked
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.recorders import BoardRecorder
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.bridges.view.live_source import LiveSource
from llfsm.cli import requests as why
from llfsm.runtime.presence import hosts, remote
from llfsm.runtime.presence.hosts import FleetReader, Shown
from llfsm.whiteboard.messages.llfsm import HOSTS, status_slot, variables_slot, why_slot
from waiting import PATIENCE_S, wait_for

from .conftest import LLFSM, NAME, Host, MakeHost, number_slot
from .test_topologies import router

MACHINE_SLOTS = status_slot, variables_slot, why_slot
MACHINES = Path(__file__).parents[2] / "cli/machines.py"


class Fleet(NamedTuple):
    robot: Host
    operator: Host

    def run(self, *arguments: str, host: Host | None = None) -> subprocess.CompletedProcess[str]:
        host = host or self.operator
        return call(*arguments, *host.select, cwd=host.directory)

    def ps(self, *arguments: str, host: Host | None = None) -> dict[str, dict[str, Any]]:
        done = self.run("ps", "--json", *arguments, host=host)
        rows = map(json.loads, done.stdout.splitlines())
        return {row["machine"]: row for row in rows}


def configured(host: Host, more: str = "") -> tuple[str, str]:
    """Return the arguments by which a daemon's host is named as its folder."""
    settings, name = host.directory / "settings.toml", host.directory.name
    fleet = 'fleet = ["robot*", "operator"]\neager = false\n'
    settings.write_text(f'as = "{name}"\n{fleet}{more}')
    return "--config", str(settings)


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands wait for a busy machine, whose machines are slow, not silent."""
    for module in (hosts, remote, why):
        monkeypatch.setattr(module, "PATIENCE_S", PATIENCE_S)
    for module in (hosts, remote):
        monkeypatch.setattr(module, "SILENT_S", PATIENCE_S)


@pytest.fixture
def fleet(make_host: MakeHost) -> Iterator[Fleet]:
    """One robot with a machine, and an operator with one, too."""
    hosts = {name: make_host(name) for name in ("robot7", "operator")}
    robot, operator = hosts.values()
    processes = []
    for host in hosts.values():
        host.start(*configured(host), connect=[robot] if host is operator else [])
        command = [*LLFSM, "run", f"{MACHINES}:Counts", "-q", *host.select]
        processes.append(Forked(command, text=True, stdout=subprocess.PIPE))
    for process in processes:
        assert process.stdout is not None
        assert process.stdout.readline() == "Counts entered A\n"
    yield Fleet(robot, operator)
    for process in processes:
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()


def test_the_machines_of_a_fleet_are_listed_and_controlled(fleet: Fleet) -> None:
    assert list(fleet.ps()) == ["Counts"], "only what is read travels"
    hosts = {"Counts": "operator", "robot7/Counts": "robot7"}
    wait_for(lambda: {name: row["as"] for name, row in fleet.ps("--fleet").items()} == hosts)
    wait_for(lambda: list(fleet.ps("--host", "robot7")) == ["robot7/Counts"])
    assert list(fleet.ps("--host", "operator")) == ["Counts"]
    wait_for(lambda: "robot7" in fleet.run("ps", "--fleet").stdout)
    head = fleet.run("ps", "--fleet").stdout.splitlines()[0]
    assert head.split()[:2] == ["HOST", "MACHINE"]

    done = fleet.run("suspend", "robot7/Counts")
    assert done.stdout == "robot7/Counts is suspended in Suspended\n", done.stderr
    assert fleet.ps(host=fleet.robot)["Counts"]["status"] == "suspended"
    assert fleet.ps()["Counts"]["status"] == "running", "the operator's machine of that name"
    assert fleet.run("resume", "robot7/Counts").returncode == 0
    assert fleet.ps(host=fleet.robot)["Counts"]["status"] == "running"
    assert fleet.run("pause", "robot7/Counts").returncode == 0
    assert fleet.run("continue", "robot7/Counts").returncode == 0
    assert fleet.run("why", "robot7/Counts").stdout.startswith("it is in A")

    unknown = "no host 'robot8' can be reached; there are: operator, robot7"
    wait_for(lambda: unknown in fleet.run("ps", "--host", "robot8").stderr)
    assert fleet.run("ps", "--host", "robot8").returncode == 1
    done = fleet.run("ps", "--host", "yard")
    assert "the `fleet` of this host does not list 'yard'" in done.stderr


def test_a_status_that_was_read_before_is_waited_for_anew(fleet: Fleet) -> None:
    board = fleet.operator.board
    for _ in range(3):
        begun_ns = time.monotonic_ns()
        with FleetReader(board, "robot7", machines=True) as reader:
            reader.settle()
            sample = board[status_slot("robot7/Counts")].sample()
            assert sample is not None
            assert sample.stamp_ns >= begun_ns


def test_machines_that_have_ended_are_not_waited_for(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For longer than a living one may take to publish its status."""
    assert fleet.run("stop", "robot7/Counts").stdout == "robot7/Counts has ended\n"
    monkeypatch.setattr(hosts, "SILENT_S", 0.1)
    monkeypatch.setattr(hosts, "PATIENCE_S", math.inf)
    for host in "robot7", "":
        with FleetReader(fleet.operator.board, host, machines=True) as reader:
            reader.settle()
    assert list(fleet.ps("--fleet")) == ["Counts"]


@pytest.mark.parametrize("command", ["get", "watch"])
def test_a_slot_of_another_host_that_is_not_read_here_is_an_error(
    fleet: Fleet, command: str
) -> None:
    fleet.robot.add(1, number_slot("arm/angle"))
    done = fleet.run("whiteboard", command, "robot7/arm/angle")
    assert done.returncode == 1
    assert "of host robot7, only what is read here arrives: see `llfsm top" in done.stderr
    for name in "arm/angle", "yard/angle":
        assert "only what is read" not in fleet.run("whiteboard", command, name).stderr


def test_what_one_host_has_is_shown(fleet: Fleet) -> None:
    """With its variables, and why its states are kept, which a viewer asks for."""
    pose, theirs = number_slot("arm/angle"), number_slot("robot7/arm/angle")
    fleet.robot.add(1, pose)
    fleet.operator.add(2, pose)
    source = LiveSource(NAME, fleet.operator.directory, host="robot7")
    wanted = {theirs.name, *(each("robot7/Counts").name for each in MACHINE_SLOTS)}
    wait_for(lambda: wanted <= source.snapshot().samples.keys(), "all of the robot")
    wait_for(lambda: source.snapshot().trouble == "")
    assert not {pose.name, status_slot("Counts").name} & source.snapshot().slots.keys()
    source.close()

    def top(*arguments: str) -> set[str]:
        return {*fleet.run("top", "--once", *arguments).stdout.split()}

    wait_for(lambda: {"robot7/Counts", theirs.name} <= top("--host", "robot7"))
    assert not {"Counts", pose.name} & top("--host", "robot7")
    wait_for(lambda: {"Counts", "robot7/Counts", pose.name, theirs.name} <= top("--fleet"))


def test_a_machine_that_an_arrangement_looks_at_is_shown_as_a_whole(fleet: Fleet) -> None:
    """Without `--host`: its status is read here in any case, and so is what belongs to it."""
    operator = fleet.operator
    source = LiveSource(NAME, operator.directory)
    wait_for(lambda: status_slot("Counts").name in source.snapshot().samples)
    assert not any("robot7" in name for name in operator.board.read_slots())
    looking = operator.board[status_slot("robot7/Counts")]
    wait_for(looking.sample, "its status")
    wanted = {each("robot7/Counts").name for each in MACHINE_SLOTS}
    wait_for(lambda: wanted <= source.snapshot().samples.keys(), "all of it")
    source.close()


def test_a_recording_is_of_one_host(fleet: Fleet, tmp_path: Path) -> None:
    pose, theirs = number_slot("arm/angle"), number_slot("robot7/arm/angle")
    fleet.robot.add(1, pose)
    fleet.operator.add(2, pose)
    board, file, own = fleet.operator.board, tmp_path / "robot7.mcap", tmp_path / "own.mcap"
    wanted = {theirs.name, variables_slot("robot7/Counts").name}
    with RecordingWriter(file, {}) as writer:
        recorder = BoardRecorder(board, writer, shown=Shown(board, "robot7"))

        def are_written() -> bool:
            recorder.poll()
            writer.flush_if_due()
            return wanted <= Recording(file).slots.keys()

        wait_for(are_written, "all of the robot")
    assert not {pose.name, status_slot("Counts").name} & Recording(file).slots.keys()

    assert fleet.operator.get(theirs) == 1
    command = [*LLFSM, "record", "-o", str(own), "--host", "operator", *fleet.operator.select]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("recording")
        wait_for(lambda: pose.name in Recording(own).slots, "its own")
        process.send_signal(signal.SIGINT)
    assert theirs.name not in Recording(own).slots


def test_hosts_find_each_other_through_a_router(make_host: MakeHost, tmp_path: Path) -> None:
    client = tmp_path / "client.json5"
    client.write_text('{ mode: "client" }')
    robot, operator = make_host("robot7", ""), make_host("operator", "")
    with router() as port:
        for host in robot, operator:
            place = "--connect", f"tcp/127.0.0.1:{port}", "--zenoh", str(client)
            host.start(*configured(host, "listen = []\n"), *place)
        with FleetReader(operator.board, "robot7") as reader:

            def is_found() -> bool:
                reader.look()
                return reader.hosts() == ("operator", "robot7") and reader.problem() == ""

            wait_for(is_found, "the robot")
            robot.end()
            wait_for(lambda: reader.hosts() == ("operator",), "the end of the robot")
            assert reader.problem() == "no host 'robot7' can be reached; there are: operator"


def test_interest_ends_with_the_command(fleet: Fleet) -> None:
    """Afterwards, its slots are read no more, nor does the daemon look for hosts."""
    pose, theirs = number_slot("arm/angle"), number_slot("robot7/arm/angle")
    fleet.robot.add(1, pose)
    wait_for(lambda: "robot7/Counts" in fleet.ps("--fleet"))
    board = fleet.operator.board
    wait_for(lambda: HOSTS.name not in board.read_slots())
    assert not any("robot7" in name for name in board.read_slots())
    assert theirs.name not in {info.name for info in board.slots()}, "only machines were read"
