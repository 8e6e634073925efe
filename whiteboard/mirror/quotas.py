"""Quotas of other hosts: the shared memory and the time of this one's daemon that each may take.

A host is known by its certificate if the settings list who may write what (`access`). Otherwise,
nothing proves who has sent a message, and all other hosts share one account: with an account for
each id that is claimed, a host could have as many as it likes.

Rates are leaky buckets that may overflow once: something passes if nothing is owed, whatever it
costs, and the debt is paid off at the rate. So a message larger than what passes in a second is not
shut out for good. An idle host is at most one second ahead. Memory is counted and never given back:
a slot stays on the board. One whose name was given up serves the next name of its type there, so
that one costs nothing: the quota is for what is alive at once.

Whatever is refused, here or elsewhere, is counted under a kind, and logged once for each kind, so
that no sender can fill the log.
"""

from __future__ import annotations

import logging
from collections import Counter, defaultdict
from collections.abc import Iterator

from llfsm.whiteboard.messages.llfsm import QuotaStatus, Refusal
from llfsm.whiteboard.mirror.settings import QuotaSettings

_BURST_NS = 10**9  # a host that was idle may be ahead of its rate by what this time allows
_MAX_KINDS = 200  # a sender can cause any number
_MAX_LENGTH = 400  # characters of a log message
_log = logging.getLogger("llfsm.mirror")


class RateLimit:
    """Lets one of something pass each `period_ns`; after a rest, up to `early_ns` too early.

    This is the generic cell rate algorithm of ITU-T I.371, a leaky bucket: what comes at the
    permitted rate, but with jitter, does not wait each time.
    """

    __slots__ = ("_early_ns", "_period_ns", "due_ns")

    def __init__(self, period_ns: float, early_ns: int) -> None:
        self._period_ns = period_ns
        self._early_ns = early_ns
        self.due_ns: float = 0
        """The time from which the next one may pass."""

    def record(self, now_ns: int, number: int = 1) -> None:
        """Record that so many pass now."""
        self.due_ns = max(self.due_ns, now_ns - self._early_ns) + number * self._period_ns


class Account:
    """Counts how much of its quota one host has taken."""

    def __init__(self, settings: QuotaSettings) -> None:
        self._settings = settings
        self._traffic = RateLimit(1e9 / settings.traffic, _BURST_NS)
        self._messages = RateLimit(1e9 / settings.messages, _BURST_NS)
        self._failed: dict[tuple[str, int], str] = {}
        self._made: dict[str, tuple[int, int]] = {}  # the type and the memory of each living slot
        self.spare: Counter[tuple[int, int]] = Counter()
        """The number of slots whose names were given up, by their type and memory."""
        self.slots = 0
        self.bytes = 0
        self.over_rate = 0

    def admits(self, size: int, now_ns: int) -> bool:
        """Take `size` bytes of traffic; return False, counted, if the host is over a rate."""
        if self._traffic.due_ns > now_ns or self._messages.due_ns > now_ns:
            self.over_rate += 1
            return False
        self._traffic.record(now_ns, size)
        return True

    def is_over(self, now_ns: int) -> bool:
        """Check for a debt of over a second, for which the rest of a batch is dropped; count it."""
        over = self._messages.due_ns > now_ns + _BURST_NS
        self.over_rate += over
        return over

    def charge(self, now_ns: int, *, messages: int, size: int = 0) -> None:
        """Take the time for messages, looked at or sent, and the traffic for what is sent."""
        self._messages.record(now_ns, messages)
        if size:
            self._traffic.record(now_ns, size)

    def failure(self, name: str, kind: int) -> str | None:
        """Return the reason why a slot of this type could not be used before, or None."""
        return self._failed.get((name, kind))

    def take_slot(self, name: str, kind: int, memory: int) -> None:
        """Take a slot and its shared memory; raise `Refused` if that is over the quota."""
        limits, like = self._settings, (kind, memory)
        if self.spare[like]:
            self.spare[like] -= 1
            self._made[name] = like
            return
        if self.slots >= limits.slots:
            raise Refused(f"slot {name!r}: over the quota of {limits.slots} slots")
        if self.bytes + memory > limits.bytes:
            raise Refused(
                f"slot {name!r}: with its {memory} bytes of shared memory, its sender would be "
                f"over the quota of {limits.bytes}"
            )
        self.slots += 1
        self.bytes += memory
        self._made[name] = like

    def give_back(self, name: str) -> None:
        """Count a slot whose name was given up as room for another one of its type."""
        like = self._made.pop(name, None)
        if like is not None:
            self.spare[like] += 1

    def fail(self, name: str, kind: int, memory: int, why: str) -> None:
        """Record that a slot that was taken cannot be used. It stays counted: it has cost time."""
        self.bytes -= memory
        self._made.pop(name, None)
        self._failed[name, kind] = why


class Quotas:
    """The accounts of the other hosts, by the name in their certificate; "" for all without."""

    def __init__(self, settings: QuotaSettings) -> None:
        self._settings = settings
        self._accounts = defaultdict[str, Account](lambda: Account(settings))

    def account(self, name: str) -> Account:
        """Return the account of a host."""
        return self._accounts[name]

    def give_back(self, name: str) -> None:
        """Count a slot whose name was given up as room for another, for the host that made it."""
        for account in self._accounts.values():
            account.give_back(name)

    def status(self) -> Iterator[QuotaStatus]:
        """Report how much of its quota each host has taken."""
        for name, taken in self._accounts.items():
            yield QuotaStatus(
                name=name,
                slots=taken.slots - taken.spare.total(),
                max_slots=self._settings.slots,
                bytes=taken.bytes,
                max_bytes=self._settings.bytes,
                over_rate=taken.over_rate,
            )


class Refused(Exception):  # noqa: N818  not for users: it is counted and logged
    """Raised when a message cannot enter the board; the text gives the reason."""


class Gone(Refused):
    """Raised when a slot's name was given up meanwhile."""


class Refusals:
    """Counts refusals by their kind, and logs the first of each kind."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def add(self, kind: str, reason: str) -> None:
        """Count a refusal under `kind`; `reason` is logged for the first one."""
        if kind not in self._counts and len(self._counts) >= _MAX_KINDS:
            kind = reason = "everything else"
        self._counts[kind] += 1
        if self._counts[kind] == 1:
            _log.warning("refused: %s", reason[:_MAX_LENGTH])

    def report(self) -> tuple[Refusal, ...]:
        """Return all refusals, the most frequent first."""
        return tuple(Refusal(kind, count) for kind, count in self._counts.most_common())
