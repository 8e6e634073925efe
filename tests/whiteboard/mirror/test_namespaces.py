"""Three hosts, each in a network namespace, and a switch between them that can be cut."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from waiting import wait_for

from .conftest import Host
from .switch import HOSTS, Switch, address, run

pytestmark = pytest.mark.timeout(240)


class Watch:
    """Checks all the time that no board goes back to an older message.

    Each message's value is the time of its add: all are added by this process, in order.
    """

    def __init__(self, hosts: list[Host]) -> None:
        self._hosts = hosts
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.went_back: list[tuple[int, int]] = []
        self.looks = 0

    def _run(self) -> None:
        seen = [0] * len(self._hosts)
        while not self._stop.wait(0.001):
            for i, host in enumerate(self._hosts):
                value = host.get() or 0
                if value < seen[i]:
                    self.went_back.append((seen[i], value))
                seen[i] = value
                self.looks += 1

    def __enter__(self) -> Watch:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()


def test_boards_agree_soon_after_all_that_happens(switch: Switch, hosts: list[Host]) -> None:
    def agree(value: int) -> float:
        return wait_for(lambda: [host.get() for host in hosts] == [value] * HOSTS)

    first, *others = hosts
    first.add(1)
    for host in hosts:
        host.start(connect=[other for other in hosts if other is not host])
    agree(1)
    with Watch(hosts) as watch:
        for value in range(2, 20):
            hosts[value % HOSTS].add(value)
            agree(value)

        switch.cut(2)
        cut = time.monotonic()
        value = 20
        while time.monotonic() - cut < 10:
            for host in (first, hosts[2]):  # on both sides
                host.add(value)
                value += 1
            time.sleep(0.05)
        wait_for(lambda: others[0].get() == value - 2)
        switch.join(2)
        assert agree(value - 1) < 5  # TCP, left to itself, would take more than six

        hosts[1].end(signal.SIGKILL)
        first.add(value)
        hosts[1].add(value + 1)
        start = time.monotonic()
        hosts[1].start(connect=[first, hosts[2]])
        ready = time.monotonic() - start
        agree(value + 1)
        assert time.monotonic() - start - ready < 5
    assert watch.looks > 1000
    assert watch.went_back == []
    assert hosts[0].status()["refused"] == []


LISTENERS = """
import json, sys, zenoh

def listen():
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5("connect/endpoints", json.dumps(sys.argv[1:2]))
    config.insert_json5("transport/link/tx/lease", "1500")
    config.insert_json5("transport/shared_memory/enabled", "false")  # a killed one would leave it
    session = zenoh.open(config)
    return session, session.declare_subscriber("llfsm/**", lambda sample: None)

listeners = [listen() for _ in range(int(sys.argv[2]))]
print("ready", flush=True)
sys.stdin.read()
"""


def test_hosts_that_are_lost_at_once_silence_no_other(switch: Switch, hosts: list[Host]) -> None:
    """More of them than the daemon has threads: none may wait for what a lost host has not got."""
    first, second, _ = hosts
    first.start()
    second.start(connect=[first])
    command = ["ip", "netns", "exec", switch.hosts[2], sys.executable, "-c", LISTENERS]
    with subprocess.Popen(
        [*command, first.endpoint, "16"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as lost:
        try:
            assert lost.stdout is not None
            assert lost.stdout.readline() == "ready\n"
            first.add(0)
            wait_for(lambda: second.get() == 0)
            switch.cut(2)
            cut, value = time.monotonic(), 0
            while time.monotonic() - cut < 3:  # they are given up after 1.5 s
                value += 1
                first.add(value)
                assert wait_for(lambda value=value: second.get() == value) < 1
        finally:
            lost.kill()


@pytest.mark.parametrize("mode", ["router", "client"])
def test_a_star(switch: Switch, hosts: list[Host], tmp_path: Path, mode: str) -> None:
    """Two that reach only the one in the middle, a router, which is killed and started again."""
    centre, *ends = hosts
    for end, other in ((1, 2), (2, 1)):
        run(f"ip -n {switch.hosts[end]} route add blackhole {address(other)}/32")
    router, other_mode = tmp_path / "router.json5", tmp_path / "other.json5"
    router.write_text('{ mode: "router" }')
    other_mode.write_text(f'{{ mode: "{mode}" }}')
    centre.start("--zenoh", str(router))
    for end in ends:
        end.start("--zenoh", str(other_mode), connect=[centre])
    for value, host in enumerate((*hosts, *hosts), 1):
        host.add(value)
        wait_for(lambda value=value: [host.get() for host in hosts] == [value] * HOSTS)
    wait_for(lambda: [len(host.status()["peers"]) for host in hosts] == [2, 2, 2])

    centre.end(signal.SIGKILL)
    ends[0].add(7)
    ends[1].add(8)
    centre.start("--zenoh", str(router))
    wait_for(lambda: [host.get() for host in hosts] == [8] * HOSTS)
    ends[0].add(9)
    wait_for(lambda: [host.get() for host in hosts] == [9] * HOSTS)
