"""The assumptions about Zenoh's undocumented behaviour, a test each.

If a test fails with a new version of Zenoh, adapt the function of zenoh_internals.py that states
the assumption, then the upper bound in pyproject.toml.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import zenoh

from free_ports import free_endpoint
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.zenoh_config import configure
from llfsm.whiteboard.mirror.zenoh_internals import error_text, limit_link, parse_refusal
from waiting import PATIENCE_S, wait_for

from .conftest import Certify


def assume(holds: object, assumption: str) -> None:
    assert holds, f"Zenoh {version('eclipse-zenoh')} breaks an assumption: {assumption}"


def assume_soon(holds: Callable[[], object], assumption: str) -> None:
    with suppress(AssertionError):
        wait_for(holds)
    assume(holds(), assumption)


# ---- Threads --------------------------------------------------------------------------------

THREADS = """
import json, sys, threading, zenoh
from pathlib import Path
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.zenoh_config import configure
from llfsm.whiteboard.mirror.zenoh_internals import callback_in_receiver, use_few_threads
_, endpoint, how = sys.argv
use_few_threads()
here = zenoh.open(configure(Settings(listen=(endpoint,)), "peer"))
there = zenoh.open(configure(Settings(listen=(), connect=(endpoint,)), "peer"))
mine, calls, names, some = threading.local(), [], set(), threading.Event()
def receive(*_):
    names.add(Path("/proc/thread-self/comm").read_text().strip())
    mine.calls = getattr(mine, "calls", 0) + 1
    calls.append(mine.calls)
    if len(calls) == 50:
        some.set()
if how == "plain":
    handler = zenoh.handlers.Callback(receive, indirect=False)
else:
    handler = callback_in_receiver(receive)
subscriber = here.declare_subscriber("key", handler)
while not some.wait(0.01):
    there.put("key", b"")
pools = {path.read_text().strip() for path in Path("/proc/self/task").glob("*/comm")}
there.close()
here.close()
print(json.dumps({"pools": sorted(pools), "receivers": sorted(names), "calls": calls}))
"""


def in_threads(how: str) -> dict[str, Any]:
    """Receive messages in a process of its own; return its threads, and the calls of each."""
    environment = {key: value for key, value in os.environ.items() if key != "ZENOH_RUNTIME"}
    command = [sys.executable, "-c", THREADS, free_endpoint(), how]
    done = subprocess.run(command, text=True, capture_output=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


@pytest.fixture(scope="module")
def plain() -> dict[str, Any]:
    return in_threads("plain")


@pytest.fixture(scope="module")
def attached() -> dict[str, Any]:
    return in_threads("attached")


def test_the_environment_configures_the_thread_pools(attached: dict[str, Any]) -> None:
    pools = {name.partition("-")[0] for name in attached["pools"]}
    assume("rx" in pools, "the threads that receive are named rx-N")
    assume(
        not pools & {"net", "acc"},
        "ZENOH_RUNTIME is read when the first session opens, and lets `rx` do the work of others",
    )


def test_a_callback_runs_in_the_thread_that_received_the_message(attached: dict[str, Any]) -> None:
    assume(
        all(name.startswith("rx-") for name in attached["receivers"]),
        "a callback with indirect=False runs in a thread of the pool `rx`",
    )


def test_a_callback_has_a_thread_state_of_its_own(plain: dict[str, Any]) -> None:
    assume(
        max(plain["calls"]) == 1,
        "each callback makes a new thread state of Python (if not, callback_in_receiver need not "
        "call PyGILState_Ensure)",
    )


def test_a_thread_keeps_a_state_that_was_not_released(attached: dict[str, Any]) -> None:
    """And the process ends well, see above."""
    assume(
        max(attached["calls"]) > 1,
        "a thread of the pool receives many messages, and keeps the state of PyGILState_Ensure",
    )


# ---- Sockets --------------------------------------------------------------------------------


def socket_options(option: int) -> list[int]:
    """Return an option of all TCP sockets of this process."""
    found = []
    for number in os.listdir("/proc/self/fd"):
        with suppress(OSError), socket.socket(fileno=os.dup(int(number))) as each:
            found.append(each.getsockopt(socket.IPPROTO_TCP, option))
    return found


def test_a_connection_is_a_socket_that_its_ports_identify() -> None:
    endpoint, timeout_ms = free_endpoint(), 123_456
    with (
        zenoh.open(configure(Settings(listen=(endpoint,)), "peer")) as here,
        zenoh.open(configure(Settings(listen=(), connect=(endpoint,)), "peer")),
    ):
        wait_for(here.info.links)
        (link,) = here.info.links()
        assume(
            limit_link(link, timeout_ms),
            f"a connection is a TCP socket of this process with the ports in {link}",
        )
        assert socket_options(socket.TCP_USER_TIMEOUT).count(timeout_ms) == 1


# ---- Log ------------------------------------------------------------------------------------

LOG = """
import sys, zenoh
from llfsm.whiteboard.mirror import zenoh_internals
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.zenoh_config import configure
_, endpoint, ours, theirs = sys.argv
zenoh.init_log_from_env_or(zenoh_internals.LOG_FILTER)
here = zenoh.open(configure(Settings(listen=(endpoint,), zenoh=ours), "peer"))
there = zenoh.open(configure(Settings(listen=(), connect=(endpoint,), zenoh=theirs), "peer"))
sys.stdin.read()
"""


@pytest.fixture
def log(certify: Certify, tmp_path: Path) -> Iterator[Callable[[], list[str]]]:
    """Let two sessions refuse each other's certificates; yield what reads standard output."""
    path = tmp_path / "log"
    files = certify("robot", "ours"), certify("stranger", "theirs")
    command = [sys.executable, "-c", LOG, free_endpoint("localhost", "tls"), *map(str, files)]
    environment = {key: value for key, value in os.environ.items() if key != "RUST_LOG"}
    with path.open("w") as out:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=out, env=environment)
    yield lambda: path.read_text().splitlines()
    process.communicate(timeout=PATIENCE_S)


def test_the_log_goes_to_standard_output(log: Callable[[], list[str]]) -> None:
    assume_soon(log, "init_log_from_env_or writes the log to file descriptor 1")


def test_a_refused_outgoing_connection_is_logged_in_known_words(
    log: Callable[[], list[str]],
) -> None:
    assume_soon(
        lambda: any(found[0].startswith("by tls/localhost:") for found in refusals(log())),
        "the log reports an outgoing connection that is refused, in the words of _OUTGOING",
    )


def test_a_refused_incoming_connection_is_logged_in_known_words(
    log: Callable[[], list[str]],
) -> None:
    assume_soon(
        lambda: any(found[0] == "a connection" for found in refusals(log())),
        "the log reports an incoming connection that is refused, in the words of _INCOMING",
    )


def refusals(lines: list[str]) -> list[tuple[str, str]]:
    return [found for line in lines if (found := parse_refusal(line)) is not None]


UNABLE = "zenoh::net::runtime::orchestrator: Unable to connect to configured peer"
SOURCE = "at /root/src/unicast.rs:378.. Retry in 100ms."
LINK = 'Can not create a new TLS link bound to DnsName("robot"):'


@pytest.mark.parametrize(
    ("line", "found"),
    [
        (
            "\x1b[2mT\x1b[0m \x1b[33m WARN\x1b[0m rx-2 \x1b[2mzenoh_link_tls::unicast\x1b[0m"
            "\x1b[2m:\x1b[0m invalid peer certificate: UnknownIssuer. Hint: increase the limit.",
            ("a connection", "invalid peer certificate: UnknownIssuer"),
        ),
        (
            f"T DEBUG rx-1 {UNABLE} tls/robot:1! {LINK} invalid peer certificate: Expired {SOURCE}",
            ("by tls/robot:1", "invalid peer certificate: Expired"),
        ),
        (
            f"T DEBUG rx-1 {UNABLE} tls/[::1]:1! received fatal alert: UnknownCA {SOURCE}",
            ("by tls/[::1]:1", "received fatal alert: UnknownCA"),
        ),
        (f"T DEBUG rx-1 {UNABLE} tls/robot:1! deadline has elapsed. Retry in 100ms.", None),
        (f"T DEBUG {UNABLE} tls/r:1! {LINK} Connection refused (os error 111) {SOURCE}", None),
        ("T DEBUG rx-1 zenoh::net::runtime::orchestrator: Try to connect: tls/robot:1", None),
        ("", None),
    ],
)
def test_a_refusal_is_parsed_and_another_line_is_not(
    line: str, found: tuple[str, str] | None
) -> None:
    assert parse_refusal(line) == found


# ---- Errors ---------------------------------------------------------------------------------


def test_an_error_has_positions_in_the_sources_which_are_removed() -> None:
    with pytest.raises(zenoh.ZError) as wrapped:
        zenoh.Config().insert_json5("listen/endpoints", '["nonsense"]')
    taken = free_endpoint()
    with (
        zenoh.open(configure(Settings(listen=(taken,)), "peer")),
        pytest.raises(zenoh.ZError) as positions,
    ):
        zenoh.open(configure(Settings(listen=(taken,)), "peer"))
    for raised, start in ((wrapped, "Endpoints must be"), (positions, "Can not create")):
        text = error_text(raised.value)
        assume(
            text.startswith(start) and ".rs:" not in text,
            f"positions in errors look like ' at /path/file.rs:1' in {raised.value}",
        )
