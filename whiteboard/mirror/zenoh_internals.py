"""Workarounds that rely on undocumented behaviour of Zenoh; nothing else in llfsm does.

Each function states the behaviour that it assumes. A test of its own checks each assumption
against the installed version (tests/whiteboard/mirror/test_zenoh_internals.py), and pyproject.toml
excludes versions that were not tested.
"""

from __future__ import annotations

import os
import re
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from ctypes import pythonapi
from stat import S_ISSOCK
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import zenoh


# ---- Threads --------------------------------------------------------------------------------

# The thread that receives a message runs the callback itself instead of waking another one.
# Sending keeps threads of its own, because a forwarded message may wait for room there.
_RUNTIME = "(rx: (worker_threads: 4), net: (handover: rx), acc: (handover: rx))"
_MAX_ATTACHED = 64  # threads that stay attached to Python; Zenoh may replace some over time


def use_few_threads() -> None:
    """Configure Zenoh's thread pools, unless the environment does; before the first session.

    Assumes that Zenoh reads ``ZENOH_RUNTIME`` when the first session opens, in this format.
    """
    os.environ.setdefault("ZENOH_RUNTIME", _RUNTIME)


def callback_in_receiver(
    receive: Callable[[str, bytes], object],
) -> zenoh.handlers.Callback[zenoh.Sample]:
    """Make a handler that calls `receive` with key and payload, in the thread that received them.

    Assumes that this is one of a few threads of Zenoh's pool, and that each callback creates a
    thread state of Python and deletes it at its end, which costs more than the callback. One
    `PyGILState_Ensure` without its release keeps the state for the thread's life.
    """
    from zenoh.handlers import Callback

    attached: set[int] = set()

    def callback(sample: zenoh.Sample) -> None:
        thread = threading.get_ident()
        if thread not in attached and len(attached) < _MAX_ATTACHED:
            attached.add(thread)
            pythonapi.PyGILState_Ensure()
        receive(str(sample.key_expr), sample.payload.to_bytes())

    return Callback(callback, indirect=False)


# ---- Sessions -------------------------------------------------------------------------------


def open_client(config: zenoh.Config, attempt_ms: int, patience_s: float) -> zenoh.Session:
    """Open the session of a client: in attempts that end, each with a session of its own.

    A client whose time to connect is up just when it is accepted keeps this connection, for which
    all its later ones are refused, and waits for one of these. So its session never opens.

    Assumes that ``zenoh.open`` raises ZError when ``connect/timeout_ms`` is up, releases all that
    it had, and may be called again with the configuration; any other error comes before that time.
    Raise that of the last attempt that begins within `patience_s` seconds.
    """
    import zenoh

    config.insert_json5("connect/timeout_ms", str(attempt_ms))
    end_s = time.monotonic() + patience_s
    while True:
        begun_s = time.monotonic()
        try:
            return zenoh.open(config)
        except zenoh.ZError:
            now_s = time.monotonic()
            if now_s - begun_s < attempt_ms / 1e3 or now_s >= end_s:
                raise


# ---- Sockets --------------------------------------------------------------------------------

_NO_LINGER = struct.pack("ii", 0, 0)


def limit_link(link: zenoh.Link, timeout_ms: int) -> bool:
    """Drop a connection whose data is not acknowledged in time, and close it without waiting.

    Without this, the kernel retries for minutes at growing intervals, and a close waits up to ten
    seconds for the other side (eclipse-zenoh/zenoh#2350) in a thread that serves other
    connections, so hosts that vanish would silence all others.

    Assumes that a connection is a TCP socket of this process, and that the link's addresses end in
    its ports: Zenoh has no setting for this, and does not give access to its sockets. Return False
    if the socket was not found. Does nothing except on Linux.
    """
    here, there = port_of(link.src), port_of(link.dst)
    found = False
    for each in _own_sockets():
        with suppress(OSError):  # not connected
            if each.getsockname()[1:2] == (here,) and each.getpeername()[1] == there:
                each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NO_LINGER)
                each.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, timeout_ms)
                found = True
    return found


def listeners() -> set[tuple[str, int]]:
    """Return the addresses and TCP ports on which this process listens; none except on Linux.

    Assumes that Zenoh listens by TCP sockets of this process: it does not report which port it got
    for port 0.
    """
    found = set()
    for listener in _own_sockets():
        with suppress(OSError):  # not of the internet
            if listener.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                address, port = listener.getsockname()[:2]
                found.add((str(address), int(port)))
    return found


def _own_sockets() -> Iterator[socket.socket]:
    """Duplicate each socket of this process in turn; a duplicate is closed before the next one."""
    if sys.platform != "linux":
        return
    for number in sorted(map(int, os.listdir("/proc/self/fd"))):
        with suppress(OSError):  # closed since it was listed
            if S_ISSOCK(os.fstat(number).st_mode):
                with socket.socket(fileno=os.dup(number)) as found:
                    yield found


def port_of(locator: str) -> int:
    """Return the port in a locator; 0 if it has none, as that of a path."""
    port = locator.partition("?")[0].partition("#")[0].rpartition(":")[2]
    return int(port) if port.isdecimal() else 0


# ---- Log ------------------------------------------------------------------------------------

LOG_FILTER = "zenoh_link_tls=warn,zenoh_link_quic=warn,zenoh::net::runtime::orchestrator=debug"
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_INCOMING = re.compile(r"WARN .*zenoh_link_\w+::\w+: (.*?)\. Hint:")
_OUTGOING = re.compile(
    r"Unable to connect to configured peer (\S+)! (?:Can not create .*? link bound to .*?: )?"
    r"(.*?)(?: at /|\. Retry)"
)
_TLS = re.compile("certificate|alert", re.IGNORECASE)  # not: the other host is not up yet


class RefusalLog:
    """Passes each refused connection in Zenoh's log to `report`: what was refused, and why."""

    def __init__(self) -> None:
        self.report: Callable[[str, str], object] = lambda what, why: None

    def read(self, pipe: int) -> None:
        """Read the log until it ends."""
        with open(pipe, errors="replace") as lines:
            for line in lines:
                if (refusal := parse_refusal(line)) is not None:
                    self.report(*refusal)
                elif os.environ.get("RUST_LOG"):
                    print(line, end="", file=sys.stderr)  # the user has asked for Zenoh's log


@contextmanager
def refusal_log() -> Iterator[RefusalLog]:
    """Read Zenoh's log within the context; set the result's `report` to receive refusals.

    Open and close sessions within the context. Assumes that Zenoh reports refused connections in
    its log only, and logs to file descriptor 1 only. That descriptor is a pipe within the context;
    what Python prints still goes to the former standard output.
    """
    import zenoh

    sys.stdout.flush()
    out = os.dup(1)
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.close(writing)
    log = RefusalLog()
    thread = threading.Thread(target=log.read, args=(reading,), name="Zenoh's log", daemon=True)
    thread.start()
    zenoh.init_log_from_env_or(LOG_FILTER)
    try:
        with open(out, "w", closefd=False) as before, redirect_stdout(before):
            yield log
    finally:
        os.dup2(out, 1)  # closes the pipe's last writing end
        os.close(out)
        thread.join()


def parse_refusal(line: str) -> tuple[str, str] | None:
    """Find a refusal in a line of the log: what was refused, and why; None for any other line.

    Assumes the wording of Zenoh's log. Outgoing connections that fail because the other host is
    not up are not refusals.
    """
    line = _COLOUR.sub("", line)
    if incoming := _INCOMING.search(line):
        return "a connection", incoming[1]
    outgoing = _OUTGOING.search(line)
    if outgoing and _TLS.search(outgoing[2]):
        return f"by {outgoing[1]}", outgoing[2]
    return None


# ---- Errors ---------------------------------------------------------------------------------


def error_text(error: Exception) -> str:
    """Take the text of one of Zenoh's errors, without positions in Zenoh's sources.

    Assumes that positions have the form `` at /path/file.rs:1``, and how errors in JSON5 are
    wrapped. If that changes, the whole text is returned.
    """
    text = re.sub(r" at /\S+?\.rs:\d+\.?", "", str(error)).strip()
    wrapped = re.match(r'Json5Err\(Message \{ msg: "(.*?)", location: ', text)
    return wrapped[1] if wrapped else text
