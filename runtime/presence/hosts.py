"""What other hosts have, read for as long as somebody looks at it.

A host that is not eager receives the folders that are read on it. A viewer of another host does
not know them in advance: the hosts publish them.
"""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Any, Self

from llfsm.errors import did_you_mean
from llfsm.whiteboard import Board, Sample, Slot, WhiteboardError
from llfsm.whiteboard.liveness import writer_lives
from llfsm.whiteboard.messages.fleet import HOSTS, KEEPS_READ, folders_slot, viewer_slot
from llfsm.whiteboard.messages.llfsm import (
    MACHINES,
    MIRROR,
    Bell,
    MachineStatus,
    MirrorStatus,
    Viewer,
    status_slot,
)
from llfsm.whiteboard.mirror.naming import Naming

from ..engine.errors import UnknownMachineError
from .remote import PATIENCE_S, SILENT_S, Directory, RemoteMachine

__all__ = ["NO_DAEMON", "FleetReader", "HostNames", "find_machine", "keep_read"]

NO_DAEMON = "no daemon mirrors this whiteboard; start `llfsm whiteboard daemon`"
"""Why no other host can be reached, and what to do."""

_SILENT_S = 3.0  # a daemon in another container may publish no status for so long
_POLL_S = 0.02
_QUIET_S = 0.5  # without another host, all that can be reached are known


class HostNames:
    """Whose the slots and machines on a board are."""

    def __init__(self, board: Board, *, silent_s: float = _SILENT_S) -> None:
        sample = None
        with suppress(WhiteboardError):
            if any(info.name == MIRROR.name for info in board.slots()):
                sample = board[MIRROR].sample()
        self.is_mirrored = sample is not None and _is_mirrored(sample, silent_s)
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
        """Return whether slots of a host, this one or another one, have names on this board."""
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


def _is_mirrored(sample: Sample[MirrorStatus], silent_s: float) -> bool:
    """Return whether the daemon runs; one of this PID namespace may be as slow as it likes."""
    return time.monotonic_ns() - sample.stamp_ns < silent_s * 1e9 or writer_lives(sample)


class FleetReader:
    """Read what hosts have until the end of a ``with`` block.

    Args:
        board: of this host.
        host: the one to read; by default all that can be reached.
        machines: read the statuses of machines only.
        silent_s: take a daemon elsewhere that publishes nothing for so long to have ended.

    """

    def __init__(
        self,
        board: Board,
        host: str = "",
        *,
        machines: bool = False,
        silent_s: float = _SILENT_S,
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
                            self._keep_read(folder)
            if not self._host and not self.names.own:  # those of hosts without a name
                self._keep_read(MACHINES.removesuffix("/"))

    def hosts(self) -> tuple[str, ...]:
        """Return the names of the hosts that can be reached, and whose slots have names here."""
        return self.names.reached(self._board)

    def problem(self) -> str:
        """Return why the host to read cannot be, and what to do; empty if it can."""
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
        """Return whether statuses of each host with machines have arrived since then.

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

    def _keep_read(self, folder: str) -> None:
        keep_read(self._board, folder, self._read)


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
