"""Hosts of a fleet, as seen from the board of one of them, for as long as somebody looks.

A daemon keeps up to date here what is read here, and nothing else; so to look at another host is to
read slots, and to stop is to forget them.

* `HostNames`: the host whose own a slot or machine is, by name.
* `FleetReader`: a viewer of another host does not know its folders in advance, so hosts announce
  them, and what they announce is read.
* `FleetTable`: hosts as a table, from the one summary that each publishes per second, however many
  machines and slots it has. `summary_publisher` makes that.
* `Shown`: what a program shows of a board, all there is or a host of a fleet.
"""

from __future__ import annotations

import socket
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Any, Literal, NamedTuple, Self, TypeAlias

from llfsm.errors import did_you_mean
from llfsm.runtime.engine.errors import UnknownMachineError
from llfsm.runtime.presence.remote import (
    PATIENCE_S,
    SILENT_S,
    Directory,
    RemoteMachine,
    StatusSlots,
    condition_of,
    is_live,
)
from llfsm.whiteboard import Board, Sample, Slot, WhiteboardError
from llfsm.whiteboard.liveness import writer_lives
from llfsm.whiteboard.messages.llfsm import (
    DEFINITIONS,
    HOSTS,
    MACHINES,
    MIRROR,
    SUMMARIES,
    VARIABLES,
    WHYS,
    Bell,
    HostHeard,
    HostSummary,
    MachineStatus,
    MachineTrouble,
    MirrorStatus,
    Viewer,
    folders_slot,
    status_slot,
    summary_slot,
    viewer_slot,
)
from llfsm.whiteboard.mirror.naming import Naming
from llfsm.whiteboard.slot_names import KEEPS_READ

NO_DAEMON = "no daemon mirrors this whiteboard; start `llfsm whiteboard daemon`"
"""Why no other host can be reached, and what to do."""

_SILENT_S = 3.0  # a daemon in another container may publish no status for so long
_POLL_S = 0.02
_QUIET_S = 0.5  # without another host, all that can be reached are known


class HostNames:
    """The hosts whose slots and machines are on a board, by name."""

    def __init__(self, board: Board, *, silent_s: float = _SILENT_S) -> None:
        sample = None
        with suppress(WhiteboardError):
            if any(info.name == MIRROR.name for info in board.slots()):
                sample = board[MIRROR].sample()
        self.is_mirrored = sample is not None and (  # a local daemon may be as slow as it likes
            time.monotonic_ns() - sample.stamp_ns < silent_s * 1e9 or writer_lives(sample)
        )
        self.own = "" if sample is None else sample.message.name
        """The name of this host; empty if it has none."""
        self._naming = Naming(self.own, () if sample is None else sample.message.fleet)

    def of_slot(self, slot: str) -> str:
        """Return the name of the host whose own a slot is; empty if that has no name."""
        return self._naming.owner(slot)

    def of_machine(self, machine: str) -> str:
        """Return the name of the host on which a machine runs; empty if that has no name."""
        return self.of_slot(status_slot(machine).name)

    def is_known(self, host: str) -> bool:
        """Check that slots of a host, this one or another one, have names on this board."""
        return host == self.own or self.of_slot(host + KEEPS_READ) == host

    def reached(self, board: Board) -> tuple[str, ...]:
        """Return the names of the hosts that can be reached, and whose slots have names here.

        The daemon keeps them up to date while that is read.
        """
        hosts = board[HOSTS].get()
        if hosts is None or not self.is_mirrored:  # they are those of a daemon that has ended
            return ()
        return tuple(each for each in hosts.names if self.is_known(each))

    def ask(self, board: Board, host: str, viewer: Viewer) -> None:
        """Have the machines of a host publish what a viewer shows."""
        board.add_message(viewer_slot("" if host == self.own else host), viewer)


class FleetReader:
    """Read what hosts have until the end of a ``with`` block.

    Args:
        board: of this host.
        host: the one to read; by default all that can be reached.
        machines: read the statuses of machines only.
        silent_s: take a daemon elsewhere that publishes nothing for so long to have ended.

    """

    def __init__(
        self, board: Board, host: str = "", *, machines: bool = False, silent_s: float = _SILENT_S
    ) -> None:
        self._board = board
        self._silent_s = silent_s
        self.names = HostNames(board, silent_s=silent_s)
        self._host = host
        self._machines = machines
        self._read: dict[str, Slot[Any]] = {}
        self._before = board[HOSTS].count  # a daemon publishes them anew to each reader

    def __enter__(self) -> Self:
        self.look()
        return self

    def __exit__(self, *_: object) -> None:
        for slot in (*self._read.values(), HOSTS):
            self._board.forget(slot)

    def look(self) -> None:
        """Read what hosts have announced since; call it a few times a second."""
        # A daemon may have been started, or have ended.
        self.names = HostNames(self._board, silent_s=self._silent_s)
        with suppress(WhiteboardError):  # no room: then what is there is all
            hosts = self.hosts()
            for host in {self._host} if self._host else {*hosts}:
                if host != self.names.own:
                    for folder in self._announced(host):
                        if not self._machines or folder == MACHINES + host:
                            keep_read(self._board, folder, self._read)
            if not self._host and not self.names.own:  # those of hosts without a name
                keep_read(self._board, MACHINES.removesuffix("/"), self._read)

    def hosts(self) -> tuple[str, ...]:
        """Return the names of the hosts that can be reached, and whose slots have names here."""
        return self.names.reached(self._board)

    def problem(self) -> str:
        """Say why the host cannot be read, and what to do; empty if it can."""
        host = self._host
        if host in ("", self.names.own):
            return ""
        if not self.names.is_mirrored:
            return NO_DAEMON
        if not self.names.is_known(host):
            return f"the `fleet` of this host does not list {host!r}"
        hosts = self.hosts()
        if host in hosts:
            return ""
        there = ", ".join(hosts) or "none with a name"
        return f"no host {host!r} can be reached; there are: {there}{did_you_mean(host, hosts)}"

    def settle(self) -> None:
        """Wait until the machines of the hosts are there, for a few seconds at most.

        Their statuses are those of now: one that was read before is only the latest if no other
        arrives for a second.
        """
        begun = changed = time.monotonic()
        known: tuple[object, ...] = ()
        while self.names.is_mirrored and time.monotonic() < begun + PATIENCE_S:
            self.look()
            hosts, answers = self.hosts(), self._board[HOSTS].count
            if (hosts, answers, len(self._read)) != known:
                known, changed = (hosts, answers, len(self._read)), time.monotonic()
            wanted = {*hosts} & {self._host} if self._host else {*hosts}
            quiet_s = 0.0 if self._host in hosts else _QUIET_S
            has_answered = answers != self._before and time.monotonic() >= changed + quiet_s
            since = begun if time.monotonic() < changed + SILENT_S else 0.0
            if has_answered and self._is_there(wanted, round(since * 1e9)):
                return
            time.sleep(_POLL_S)  # several slots at once, and a host that may never answer

    def _is_there(self, hosts: set[str], since_ns: int) -> bool:
        """Check that statuses of each host with machines have arrived since then.

        Of those that were loaded, all have to; of a host with none, one.
        """
        arrived, missing = set[str](), set[str]()
        for name, sample in Directory(self._board).statuses():
            host = self.names.of_machine(name)
            if sample.stamp_ns >= since_ns:
                arrived.add(host)
            elif sample.message.loaded:
                missing.add(host)
        for host in hosts - (arrived - missing) - {self.names.own}:
            folders = self._announced(host)
            if not folders or MACHINES + host in folders:
                return False
        return True

    def _announced(self, host: str) -> tuple[str, ...]:
        slot = folders_slot(host)
        self._read.setdefault(slot.name, slot)
        message = self._board[slot].get()
        return () if message is None else message.folders


def keep_read(board: Board, folder: str, read: dict[str, Slot[Any]]) -> None:
    """Read a folder until its slot in `read`, into which that is put, is forgotten."""
    name = folder + KEEPS_READ
    if name not in read:
        kind = MachineStatus if name.startswith(MACHINES) else Bell
        slot = read[name] = Slot[Any](name, kind)
        board[slot].sample()


def find_machine(board: Board, name: str) -> RemoteMachine:
    """Return a machine of this host, or of another one, from which nothing may have come yet.

    Raise `UnknownMachineError` naming those there are.
    """
    names = HostNames(board)
    host = names.of_machine(name)
    try:
        return Directory(board).find(name)
    except UnknownMachineError:
        if not host or host == names.own:
            raise
        with FleetReader(board, host, machines=True) as fleet:
            fleet.settle()
            return Directory(board).find(name)


Trouble: TypeAlias = Literal["lost", "failed", "clock", ""]
"""The worst about a host: it is silent, a machine is in trouble, its clock is wrong; or ""."""

_WRONG_CLOCK_S = 1.0
_LEADS = 10  # summaries from which a clock's lead is estimated


class HostRow(NamedTuple):
    """All that is known of a host, as a row of the table."""

    name: str
    is_own: bool
    """True if it is this host."""
    is_there: bool
    """True while it can be reached."""
    contact_ns: int | None
    """When its latest summary arrived, by the monotonic clock; None before the first."""
    lead_s: float | None
    """How far its clock is ahead of this host's, or a little less: as much as messages take."""
    summary: HostSummary | None
    trouble: Trouble


class _Known:
    """The summaries that were received of a host."""

    def __init__(self) -> None:
        self.is_there = True
        self.begun_ns = time.monotonic_ns()  # before, it may have travelled to nobody here
        self.sample: Sample[HostSummary] | None = None
        self._leads_s: deque[float] = deque(maxlen=_LEADS)

    def take(self, sample: Sample[HostSummary] | None, ahead_ns: int) -> None:
        """Take the latest summary, which may be the one before."""
        if sample is None or (self.sample is not None and sample.count == self.sample.count):
            return
        if self.sample is not None:  # the first may be an old one, which was asked for
            self._leads_s.append((sample.message.sent_ns - sample.stamp_ns - ahead_ns) / 1e9)
        self.sample = sample

    @property
    def lead_s(self) -> float | None:
        """The largest of the last leads: its message was the fastest."""
        return max(self._leads_s, default=None)


class FleetTable:
    """The hosts that can be reached, or have been, until the end of a ``with``.

    What a host has published stays on the board, so those that were seen before are known.

    Args:
        board: of this host.
        silent_s: a host whose summary is older is lost. They are published once a second.

    """

    def __init__(self, board: Board, *, silent_s: float = 3.0) -> None:
        self._board = board
        self._silent_ns = silent_s * 1e9
        self._names = HostNames(board)
        self._known: dict[str, _Known] = {}

    def __enter__(self) -> Self:
        self.look()
        return self

    def __exit__(self, *_: object) -> None:
        self._board.forget(HOSTS)
        for name in self._known:
            self._board.forget(self._slot(name))

    def look(self) -> None:
        """Read what has arrived since; call it a few times a second."""
        names = HostNames(self._board)
        if names.own != self._names.own:  # another daemon: this host's own slot is another one
            self.__exit__()
            self._known = {}
        self._names = names
        ahead_ns = time.time_ns() - time.monotonic_ns()
        with suppress(WhiteboardError):  # no room for a slot: then what is there is all
            hosts = names.reached(self._board)
            for name in (*hosts, *self._seen()):
                self._known.setdefault(name, _Known())
            for name, known in self._known.items():
                known.is_there = name in hosts
                known.take(self._board[self._slot(name)].sample(), ahead_ns)

    def _seen(self) -> Iterator[str]:
        """Return the hosts whose summaries are on the board."""
        for info in self._board.slots():
            if info.name.startswith(SUMMARIES):
                name = info.name.removeprefix(SUMMARIES).strip("/")
                if name != self._names.own and self._names.is_known(name):
                    yield name

    def rows(self) -> list[HostRow]:
        """Return a row for each host, by name."""
        now_ns = time.monotonic_ns()
        return [self._row(name, self._known[name], now_ns) for name in sorted(self._known)]

    def problem(self) -> str:
        """Say why there is nothing to show, and what to do; empty if nothing is wrong."""
        return "" if self._names.is_mirrored else NO_DAEMON

    def _slot(self, name: str) -> Slot[HostSummary]:
        return summary_slot("" if name == self._names.own else name)

    def _row(self, name: str, known: _Known, now_ns: int) -> HostRow:
        sample, lead_s = known.sample, known.lead_s
        trouble: Trouble = ""
        is_silent = (
            sample is not None and now_ns - max(sample.stamp_ns, known.begun_ns) > self._silent_ns
        )
        if not known.is_there or is_silent:
            trouble = "lost"
        elif sample is not None and sample.message.troubled:
            trouble = "failed"
        elif lead_s is not None and abs(lead_s) > _WRONG_CLOCK_S:
            trouble = "clock"
        contact_ns, summary = (None, None) if sample is None else (sample.stamp_ns, sample.message)
        is_own = name == self._names.own
        return HostRow(name, is_own, known.is_there, contact_ns, lead_s, summary, trouble)


def hearing(rows: Sequence[HostRow]) -> dict[str, dict[str, HostHeard]]:
    """Map each host to the others that it hears, by their names, from their summaries.

    A host without a summary is left out; one that has no name for others has that of its network.
    """
    names = {row.summary.host: row.name for row in rows if row.summary is not None}
    return {
        row.name: {names.get(each.host, each.name): each for each in row.summary.hears}
        for row in rows
        if row.summary is not None
    }


_LOOK_S = 0.25  # between two looks for what hosts have announced
_BESIDE_STATUSES = (DEFINITIONS, VARIABLES, WHYS)


class Shown:
    """The part of a board that a program shows; what is read for it is, until the board is closed.

    Args:
        board: of this host.
        host: show only what is of this host of the fleet; by default, what is on the board.
        fleet: read what all hosts have.

    """

    def __init__(self, board: Board, host: str = "", *, fleet: bool = False) -> None:
        self._board = board
        self._host = host
        self.fleet = FleetReader(board, host) if host or fleet else None
        """The reader of other hosts, if there is one."""
        self._look_s = 0.0  # when to look again
        self._directory = Directory(board)
        self._read: dict[str, Slot[Any]] = {}

    def look(self) -> None:
        """Read what hosts have announced; a few times a second, however often it is called."""
        now_s = time.monotonic()
        if now_s >= self._look_s:
            self._look_s = now_s + _LOOK_S
            if self.fleet is not None:
                self.fleet.look()
            else:
                self._read_machines()

    def _read_machines(self) -> None:
        """Read all that machines of other hosts publish whose statuses are on the board.

        For an arrangement that looks at one, these alone are read.
        """
        names = HostNames(self._board)
        if not names.is_mirrored:
            return
        with suppress(WhiteboardError):  # no room: then what is there is all
            hosts = {names.of_machine(each.name) for each in self._directory.machines()}
            for host in hosts - {"", names.own}:
                for kind in _BESIDE_STATUSES:
                    keep_read(self._board, kind + host, self._read)

    def has(self, slot: str) -> bool:
        """Return True if a slot on the board is shown."""
        if self.fleet is None or not self._host:
            return True
        return self.fleet.names.of_slot(slot) == self._host

    def ask(self, viewer: Viewer, slots: Iterable[str]) -> None:
        """Have the machines whose statuses are among the slots publish what a viewer shows.

        Those of this host are asked in any case, unless another one is shown.
        """
        names = HostNames(self._board)
        hosts = {self._host or names.own}
        if names.is_mirrored and not self._host:
            hosts |= {names.of_slot(each) for each in slots if each.startswith(MACHINES)}
        for host in hosts:
            names.ask(self._board, host, viewer)


_MOST = 16  # machines in trouble that are named
_LONGEST = 300  # characters of an error
_TROUBLE = ("failed", "hung", "silent")


def summary_publisher(board: Board, *, died_s: float = 3600.0) -> Callable[[MirrorStatus], None]:
    """Return a function that publishes the summary of a named host, to be called once a second.

    It takes the status of the host's daemon. A machine that has died, or whose failure has ended
    its process, is reported for `died_s` seconds, or until it runs again.
    """
    slots = StatusSlots(board)

    def publish(status: MirrorStatus) -> None:
        if not status.name:  # others would not know whose it is
            return
        with suppress(WhiteboardError):  # mirroring goes on without
            slots.look(Naming(status.name, status.fleet).is_own)  # others may not be read here
            board.add_message(summary_slot(), _summary(status, slots, died_s))

    return publish


def _summary(status: MirrorStatus, slots: StatusSlots, died_s: float) -> HostSummary:
    samples = dict(sorted(_samples(slots, died_s)))
    troubles = [each for name, sample in samples.items() for each in _troubles(name, sample)]
    return HostSummary.of(
        status,
        system=socket.gethostname()[:255],
        sent_ns=time.time_ns(),
        machines=len(samples),
        troubled=len(troubles),
        troubles=tuple(troubles[:_MOST]),
    )


def _samples(slots: StatusSlots, died_s: float) -> Iterator[tuple[str, Sample[MachineStatus]]]:
    for name, sample in slots.samples():
        is_recent = time.monotonic_ns() - sample.stamp_ns <= died_s * 1e9
        counts = sample.message.loaded or sample.message.failed
        if counts and (is_recent or is_live(sample)):
            yield name, sample


def _troubles(machine: str, sample: Sample[MachineStatus]) -> Iterator[MachineTrouble]:
    status = sample.message
    if not status.loaded:
        yield MachineTrouble(machine, "failed", status.error[:_LONGEST])
        return
    if not is_live(sample):
        yield MachineTrouble(machine, "died", f"its process {status.pid} has not ended it")
        return
    condition = condition_of(status, (time.monotonic_ns() - sample.stamp_ns) / 1e9)
    if condition in _TROUBLE:
        yield MachineTrouble(machine, condition, status.error[:_LONGEST])
