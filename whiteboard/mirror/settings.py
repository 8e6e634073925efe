"""The settings of a daemon, as given by a file or by flags; the names of slots that they match.

The texts of endpoints are checked here, as Zenoh refuses one without a protocol by a quote of its
grammar, and takes one without a port, to which it then tries to connect for ever.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from fnmatch import translate
from functools import lru_cache
from typing import Annotated

import msgspec
from msgspec import Meta

from llfsm.whiteboard.messages.llfsm import (
    BELL,
    HOSTS,
    JOURNALS,
    MIRROR,
    RECORDER,
    STAND_INS,
    WILL_BELL,
)
from llfsm.whiteboard.mirror.naming import require_host_name
from llfsm.whiteboard.slot_names import is_own

PORT = 7447
"""Zenoh's own, and so that of a board's daemon and of a router of ROS."""

DEFAULT_ENDPOINT = f"tcp/127.0.0.1:{PORT}"
_CertificateName = Annotated[str, Meta(pattern=r"^[^/*$?#\s]{1,64}$")]
_Rate = Annotated[float, Meta(gt=0, le=10_000)]


class GuardSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The patience of guards with machines of other hosts, before they execute last wills."""

    partition_s: Annotated[float, Meta(ge=0.5, le=86_400)] = 3.0
    """Seconds: a machine that publishes no status for so long counts as dead."""


class KeepSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A file, and the slots whose latest messages outlive all hosts in it."""

    file: Annotated[str, Meta(min_length=1)]
    slots: Annotated[tuple[str, ...], Meta(min_length=1)]
    """Globs of the slots whose latest messages are kept; none of `llfsm/` is."""

    def __post_init__(self) -> None:
        if ours := [glob for glob in self.slots if is_own(glob)]:
            raise ValueError(f"slots: {ours[0]!r} keeps nothing, as no slot of llfsm/ is kept")


class QuotaSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The share of this host that each other one may take; see :mod:`.quotas`."""

    slots: Annotated[int, Meta(ge=0, le=4096)] = 1024
    """Slots that it may make on the board, from the start of the daemon on."""
    bytes: Annotated[int, Meta(ge=0, le=1 << 50)] = 1 << 29
    """Of shared memory for these slots: four buffers each, and the schema."""
    messages: Annotated[float, Meta(gt=0, le=1e9)] = 50_000.0
    """Messages of slots per second."""
    traffic: Annotated[float, Meta(gt=0, le=1e12)] = float(1 << 28)
    """Bytes per second."""


class Settings(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """The slots to mirror, the hosts to mirror them with, and the limits of both.

    Raise ``ValueError`` for a name that no host can have; decoding one raises
    ``msgspec.ValidationError`` for any wrong value.
    """

    listen: tuple[str, ...] | None = None
    """Zenoh endpoints; by default those of the file `zenoh`, else `DEFAULT_ENDPOINT`."""
    connect: tuple[str, ...] | None = None
    multicast: bool = False
    """Discover other hosts by multicast."""
    as_: Annotated[str, Meta(min_length=1)] = msgspec.field(default="", name="as")
    """This host's name: others have its own slots in a folder of that name. Empty: in none. All
    globs below are for the names of slots on this host's board."""
    fleet: tuple[str, ...] = ()
    """Globs of the other hosts' names. A host with a name has no slots of hosts that match none."""
    leave: tuple[str, ...] = ("*",)
    """Globs of the slots that other hosts receive."""
    enter: tuple[str, ...] = ("*",)
    """Globs of the slots that other hosts may add to."""
    eager: bool = True
    """Receive all that may enter; else only the folders of slots that are read on this host."""
    access: dict[_CertificateName, tuple[str, ...]] = {}
    """Globs of the slots that a host may add to, by the name in its certificate; others may add
    to none. Empty: all hosts that can connect may add to what `enter` lists."""
    read_only: bool = False
    """Let nothing enter: other hosts may only read this host's board."""
    rate: _Rate = 100.0
    """Messages of a slot that leave per second, at most."""
    rates: dict[str, _Rate] = {}
    """The same for slots by glob; the first match counts."""
    largest: Annotated[int, Meta(ge=1, le=1 << 30)] = 1 << 26
    """Bytes: slots of a larger capacity do not enter."""
    ahead_s: Annotated[float, Meta(gt=0, le=1e9)] = 86_400.0
    """Seconds: how far a message's version may be ahead of this host's clock. The default leaves
    room for a clock that is set to local time."""
    guard: GuardSettings = GuardSettings()
    keep: KeepSettings | None = None
    quota: QuotaSettings = QuotaSettings()
    zenoh: str | None = None
    """A configuration file for Zenoh, in JSON5: TLS, access control, queues."""

    def __post_init__(self) -> None:
        if self.as_:
            require_host_name(self.as_)

    @property
    def ahead_ns(self) -> int:
        """`ahead_s` in nanoseconds."""
        return int(self.ahead_s * 1e9)

    def period_ns(self) -> Callable[[str], int]:
        """Make a function that maps a slot's name to the nanoseconds between its departures."""
        rates = [(re.compile(translate(glob)), rate) for glob, rate in self.rates.items()]

        @lru_cache(maxsize=8192)
        def period_ns(slot: str) -> int:
            found = (rate for pattern, rate in rates if pattern.match(slot))
            return int(1e9 / next(found, self.rate))

        return period_ns


def matcher(globs: tuple[str, ...]) -> Callable[[str], bool]:
    """Make a predicate of slots' names, true for a match of any glob; ``*`` matches ``/``, too.

    Slots about the board itself, or for a recorder on this host, never match.
    """
    pattern = re.compile("|".join(map(translate, globs)) or r"(?!)")
    slots = (BELL, HOSTS, MIRROR, RECORDER, STAND_INS, WILL_BELL)
    private = {slot.name for slot in slots}

    @lru_cache(maxsize=8192)
    def matches(slot: str) -> bool:
        if slot in private or slot.startswith(JOURNALS):
            return False
        return pattern.match(slot) is not None

    return matches


# ---- The text of an endpoint ----------------------------------------------------------------

_WITH_PORT = ("tcp", "tls", "quic", "udp", "ws")
_ADDRESS = re.compile(r"[^:?#\s]+|\[[^\]?#\s]+\]")
_ADDRESS_AND_PORT = re.compile(rf"({_ADDRESS.pattern}):\d+")
_HOST = re.compile(r"localhost$|\[|.*\.")  # else a word may be anything


def endpoint_problem(text: str) -> str:
    """Check the text of an endpoint; return the error, with what is probably meant, or ""."""
    protocol, slash, rest = text.partition("/")
    if not slash:
        return _problem(text, "tcp", text)
    if protocol in _WITH_PORT:
        address = re.split("[?#]", rest, maxsplit=1)[0]
        if not _ADDRESS_AND_PORT.fullmatch(address):
            return _problem(text, protocol, address)
    return ""


def _problem(text: str, protocol: str, address: str) -> str:
    """Make the error, with `address` completed if it lacks no more than a port or a host."""
    if _ADDRESS_AND_PORT.fullmatch(address):
        meant = address
    elif re.fullmatch(r":?\d+", address):
        meant = f"localhost:{address.lstrip(':')}"
    elif _ADDRESS.fullmatch(address) and (text != address or _HOST.match(address)):
        meant = f"{address}:{PORT}"
    else:
        return f"{text!r} is not an endpoint such as tcp/robot.local:{PORT}"
    return f"{text!r} is not an endpoint; did you mean {protocol}/{meant}?"
