"""What is wrong with the text of a Zenoh endpoint.

Zenoh refuses a text without a protocol, and quotes its grammar. It takes one without a port and
tries for ever to connect to it.
"""

from __future__ import annotations

import re

__all__ = ["PORT", "endpoint_problem"]

PORT = 7447
"""Zenoh's own, and so that of a board's daemon and of a router of ROS."""

_WITH_PORT = ("tcp", "tls", "quic", "udp", "ws")
_ADDRESS = re.compile(r"[^:?#\s]+|\[[^\]?#\s]+\]")
_ADDRESS_AND_PORT = re.compile(rf"({_ADDRESS.pattern}):\d+")

_HOST = re.compile(r"localhost$|\[|.*\.")  # else a word may be anything


def endpoint_problem(text: str) -> str:
    """Return what is wrong with an endpoint, and what is probably meant; "" if it may be one."""
    protocol, slash, rest = text.partition("/")
    if not slash:
        return _problem(text, "tcp", text)
    if protocol in _WITH_PORT:
        address = re.split("[?#]", rest, maxsplit=1)[0]
        if not _ADDRESS_AND_PORT.fullmatch(address):
            return _problem(text, protocol, address)
    return ""


def _problem(text: str, protocol: str, address: str) -> str:
    """Return the error, with `address` completed if it lacks no more than a port or a host."""
    if _ADDRESS_AND_PORT.fullmatch(address):
        meant = address
    elif re.fullmatch(r":?\d+", address):
        meant = f"localhost:{address.lstrip(':')}"
    elif _ADDRESS.fullmatch(address) and (text != address or _HOST.match(address)):
        meant = f"{address}:{PORT}"
    else:
        return f"{text!r} is not an endpoint such as tcp/robot.local:{PORT}"
    return f"{text!r} is not an endpoint; did you mean {protocol}/{meant}?"
