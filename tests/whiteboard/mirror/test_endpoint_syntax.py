"""Endpoints as people mistype them: what is printed, and that Zenoh's own forms pass."""

from __future__ import annotations

import pytest

from llfsm.whiteboard.mirror.settings import endpoint_problem


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("0.0.0.0:7447", "tcp/0.0.0.0:7447"),
        ("localhost:7447", "tcp/localhost:7447"),
        ("localhost", "tcp/localhost:7447"),
        ("robot.local", "tcp/robot.local:7447"),
        ("7447", "tcp/localhost:7447"),
        (":7448", "tcp/localhost:7448"),
        ("tcp/robot.local", "tcp/robot.local:7447"),
        ("tls/robot", "tls/robot:7447"),
        ("tcp/7448", "tcp/localhost:7448"),
        ("[::1]:7447", "tcp/[::1]:7447"),
        ("tcp/[fe80::1]", "tcp/[fe80::1]:7447"),
        ("tcp/robot#iface=eth0", "tcp/robot:7447"),
    ],
)
def test_what_is_probably_meant_is_reported(text: str, meant: str) -> None:
    assert endpoint_problem(text) == f"{text!r} is not an endpoint; did you mean {meant}?"


@pytest.mark.parametrize("text", ["", "nonsense", "tcp/", "tcp/:", "tcp/a:b", "tcp:localhost:1"])
def test_else_an_example_is_named(text: str) -> None:
    assert endpoint_problem(text) == f"{text!r} is not an endpoint such as tcp/robot.local:7447"


@pytest.mark.parametrize(
    "text",
    [
        "tcp/localhost:0",
        "tcp/[::]:7447",
        "tls/robot.local:7451#root_ca_certificate=ca.pem",
        "udp/10.0.0.1:7447?rel=0",
        "unixsock-stream//tmp/zenoh",
        "serial//dev/ttyUSB0#baudrate=112500",
        "vsock/2:7447",
    ],
)
def test_endpoints_pass(text: str) -> None:
    assert endpoint_problem(text) == ""
