"""Hosts that know each other by certificates, made here."""

from __future__ import annotations

import pytest

from free_ports import free_endpoint
from llfsm.whiteboard import NetworkError, Whiteboard
from waiting import wait_for

from .conftest import NAME, NUMBER, Certify, Host, MakeHost, Number


def refusals(host: Host) -> dict[str, int]:
    return {each["what"]: each["count"] for each in host.status()["refused"]}


def test_hosts_of_one_authority_share_and_others_do_not(
    make_host: MakeHost, certify: Certify
) -> None:
    def tls_host(name: str) -> Host:
        return make_host(name, free_endpoint("localhost", "tls"))

    robot, laptop, stranger, thief = map(tls_host, ("robot", "laptop", "stranger", "thief"))
    robot.start("--zenoh", str(certify("robot", "ours")))
    stranger.start("--zenoh", str(certify("stranger", "theirs")), connect=[robot])
    thief.start("--zenoh", str(certify("thief", "theirs", trusts="ours")), connect=[robot])
    stranger.add(666)
    laptop.start("--zenoh", str(certify("laptop", "ours")), connect=[robot])
    robot.add(1)
    wait_for(lambda: laptop.get() == 1)
    laptop.add(2)
    wait_for(lambda: robot.get() == 2)
    assert stranger.get() == 666
    for host, why in ((stranger, "invalid peer certificate"), (thief, "received fatal alert")):
        assert host.status()["peers"] == []
        wait_for(lambda host=host: max(refusals(host).values(), default=0) > 1)
        (what,) = refusals(host)
        assert what.startswith(f"by {robot.endpoint}: {why}")
        assert host.log.count("refused: ") == 1
    for why in ("received fatal alert: UnknownCA", "invalid peer certificate: UnknownIssuer"):
        wait_for(lambda why=why: refusals(robot).get(f"a connection: {why}", 0) > 1)
    # A host that is slow to read may also see only that the other one has closed the connection.
    wait_for(lambda: robot.log.count("refused: a connection") == len(refusals(robot)))
    assert refusals(laptop) == {}
    wait_for(lambda: len(robot.status()["peers"]) == 1)

    config = str(certify("tablet", "ours"))
    with Whiteboard.connect(robot.endpoint, NAME, zenoh=config) as board:
        assert board.get_message(NUMBER) == Number(2)
    with pytest.raises(NetworkError):
        Whiteboard.connect(robot.endpoint, NAME, zenoh=str(certify("another", "theirs")))
