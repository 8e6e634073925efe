"""The command `llfsm router`."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys

import pytest

from forked import Forked
from llfsm.bridges.ros2.opening import loopback
from llfsm.bridges.ros2.zenoh_transport.transport import ZenohTransport
from waiting import PATIENCE_S

ROUTER = [sys.executable, "-m", "llfsm.cli", "router"]


@pytest.fixture
def start(free_port):
    started = []

    def start(*options):
        command = [*ROUTER, "--listen", f"tcp/127.0.0.1:{free_port}", *options]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        process = Forked(command, text=True, **pipes)
        started.append(process)
        return process, process.stdout.readline()

    yield start
    for process in started:
        with process:  # which closes its pipes
            process.kill()


def test_it_says_where_it_listens_and_nodes_meet_there(start, free_port):
    _, line = start()
    assert line == f"router: listening on tcp/127.0.0.1:{free_port}\n"
    where = [f"tcp/127.0.0.1:{free_port}"]
    with ZenohTransport(7, router=where) as one, ZenohTransport(7, router=where) as two:
        one.node("one")
        assert two.wait_graph(lambda graph: graph.nodes == ("/one",), PATIENCE_S)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_cleanly_when_it_is_asked_to(start, number):
    process, _ = start()
    process.send_signal(number)
    assert process.wait(PATIENCE_S) == 0
    assert process.stderr.read() == ""


def test_it_ends_with_its_supervisor(start):
    process, _ = start("--until-eof")
    process.stdin.close()
    assert process.wait(PATIENCE_S) == 0


def test_a_port_that_is_in_use_is_reported(free_port):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", free_port))
        taken.listen()
        done = subprocess.run(
            [*ROUTER, "--listen", f"tcp/127.0.0.1:{free_port}"],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
    assert done.returncode == 1
    assert done.stdout == ""
    assert f"Error: no router on tcp/127.0.0.1:{free_port}" in done.stderr
    assert "in use" in done.stderr
    assert "`llfsm whiteboard daemon`" in done.stderr
    assert ".rs" not in done.stderr
    assert "Traceback" not in done.stderr


def test_a_place_that_is_none_is_reported():
    done = subprocess.run(
        [*ROUTER, "--listen", "nonsense"],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.startswith("Error: no router: 'nonsense' is not an endpoint such as tcp/")


def test_by_default_only_this_host_is_listened_to():
    assert loopback()[0] == "tcp/127.0.0.1:7447"
    assert set(loopback()) <= {"tcp/127.0.0.1:7447", "tcp/[::1]:7447"}
