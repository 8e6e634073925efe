"""Links between hosts that met through a third one are made again after they broke."""

from __future__ import annotations

import signal
import socket
from collections.abc import Iterator
from contextlib import closing
from math import inf
from types import SimpleNamespace
from typing import Any

import pytest

from free_ports import free_endpoint
from llfsm.whiteboard.mirror.reconnecting import Reconnector
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.zenoh_config import configure
from waiting import wait_for

from .conftest import Certify, Host, MakeHost, number_slot

LOST_S = 3.0  # twice the time after which a connection that is silent is dropped
OWN, OTHER = "tcp/127.0.0.1:7447", "tcp/192.0.2.1:7000"


def meet(hosts: list[Host], *arguments: str) -> None:
    """Let the second and third host meet through the first one."""
    hosts[0].start(*arguments)
    for host in hosts[1:]:
        host.start(*arguments, connect=hosts[:1])
    each_hears_all(hosts, 1)


def each_hears_all(hosts: list[Host], value: int) -> None:
    for number, host in enumerate(hosts):
        host.add(value, number_slot(f"of{number}"))
    for number in range(len(hosts)):
        for host in hosts:
            wait_for(lambda host=host, number=number: host.get(number_slot(f"of{number}")) == value)


def stop_until_it_is_lost(host: Host, by: Host) -> None:
    own = host.status()["host"]

    def silent_s() -> float:
        peers = [each["silent_s"] for each in by.status()["peers"] if each["host"] == own]
        return max(peers, default=inf)

    wait_for(lambda: silent_s() < LOST_S)
    host.send(signal.SIGSTOP)
    wait_for(lambda: silent_s() > LOST_S)
    host.send(signal.SIGCONT)


@pytest.mark.parametrize("stopped", [1, 2])
def test_hosts_that_met_through_another_meet_again(make_host: MakeHost, stopped: int) -> None:
    hosts = [make_host(f"host{number}") for number in range(3)]
    meet(hosts)
    for value in (2, 3):
        stop_until_it_is_lost(hosts[stopped], by=hosts[3 - stopped])
        each_hears_all(hosts, value)
    logs = hosts[1].log + hosts[2].log
    assert "lost the connection to tcp/127.0.0.1:" in logs
    assert "connected again to tcp/127.0.0.1:" in logs
    assert "refused" not in logs


def test_they_meet_again_while_the_one_that_knew_both_is_gone(make_host: MakeHost) -> None:
    hosts = [make_host(f"host{number}") for number in range(3)]
    meet(hosts)
    hosts[0].end(signal.SIGKILL)
    stop_until_it_is_lost(hosts[1], by=hosts[2])
    hosts[1].add(2, number_slot("of1"))
    wait_for(lambda: hosts[2].get(number_slot("of1")) == 2)


def test_hosts_with_certificates_meet_again(make_host: MakeHost, certify: Certify) -> None:
    hosts = [make_host(f"host{number}", free_endpoint(protocol="tls")) for number in range(3)]
    for number, host in enumerate(hosts):
        zenoh = certify(f"host{number}", "authority")
        connect = hosts[:1] if number else []
        host.start("--zenoh", str(zenoh), connect=connect)
    each_hears_all(hosts, 1)
    stop_until_it_is_lost(hosts[1], by=hosts[2])
    each_hears_all(hosts, 2)


# ---- What is tried, and what is not ---------------------------------------------------------


@pytest.fixture
def reconnector() -> Iterator[Reconnector]:
    configured = ("tcp/192.0.2.9:7000?rel=1",)
    copy = lambda: configure(Settings(), "peer")  # noqa: E731
    with closing(Reconnector(copy, (OWN,), configured, set)) as made:
        yield made


def link(zid: str, dst: str = OTHER, src: str = "tcp/192.0.2.2:40000") -> Any:
    return SimpleNamespace(zid=zid, src=src, dst=dst)


def test_a_lost_host_is_tried_until_there_is_a_link(reconnector: Reconnector) -> None:
    reconnector.add(link("a"))
    assert reconnector.lost == ()
    reconnector.remove(link("a"))
    assert reconnector.lost == (OTHER,)
    reconnector.add(link("a", dst="tcp/192.0.2.1:41000", src=OWN))  # it has connected
    assert reconnector.lost == ()


def test_a_host_that_has_connected_as_well_is_tried(reconnector: Reconnector) -> None:
    for each in (link("a"), link("a", dst="tcp/192.0.2.1:41000", src=OWN)):
        reconnector.add(each)
    reconnector.remove(link("a"))
    assert reconnector.lost == (OTHER,)


def test_a_host_that_has_started_again_is_not_lost(reconnector: Reconnector) -> None:
    reconnector.add(link("a"))
    reconnector.remove(link("a"))
    reconnector.add(link("b"))
    assert reconnector.lost == ()


@pytest.mark.parametrize(
    "other",
    [
        link("a", dst="tcp/192.0.2.9:7000"),  # Zenoh connects to it again
        link("a", dst="tcp/192.0.2.1:41000", src=OWN),  # it had connected
    ],
)
def test_others_are_not_tried(reconnector: Reconnector, other: Any) -> None:
    reconnector.add(other)
    reconnector.remove(other)
    assert reconnector.lost == ()


def test_the_hosts_that_are_tried_are_bounded(reconnector: Reconnector) -> None:
    for number in range(1200):
        each = link(f"{number}", dst=f"tcp/192.0.2.1:{7000 + number}")
        reconnector.add(each)
        reconnector.remove(each)
    assert len(reconnector.lost) == 1000
    assert reconnector.lost[-1] == "tcp/192.0.2.1:8199"


def test_nothing_is_tried_at_a_host_that_refuses_connections() -> None:
    """A session is made for hosts that listen, and for no others."""
    made: list[None] = []

    def copy() -> Any:
        made.append(None)
        return configure(Settings(), "peer")

    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        listening.settimeout(10)
        with closing(Reconnector(copy, (OWN,), (), set)) as reconnector:
            refuses = link("a", dst=free_endpoint())
            reconnector.add(refuses)
            reconnector.remove(refuses)
            wait_for(lambda: reconnector.refusing == (refuses.dst,))
            assert made == []
            listens = link("b", dst=f"tcp/127.0.0.1:{port}")
            reconnector.add(listens)
            reconnector.remove(listens)
            listening.accept()[0].close()  # the probe
            wait_for(lambda: made)
            assert len(reconnector.lost) == 2
