"""Machines that other processes run on a whiteboard: their statuses, and requests to them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

from llfsm.runtime.engine.errors import UnknownMachineError
from llfsm.runtime.engine.events import Status
from llfsm.whiteboard.errors import MessageUnreadableError, SlotError, SlotNotFoundError
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import (
    BELL,
    MACHINES,
    Action,
    Bell,
    MachineRequest,
    MachineStatus,
    request_slot,
    status_slot,
)

if TYPE_CHECKING:
    from llfsm.whiteboard import Board, BoundSlot, Message, Sample, Slot


M = TypeVar("M", bound="Message")
Condition: TypeAlias = Literal["running", "suspended", "paused", "failed", "hung", "silent"]

_CLOCKS = {
    "runs": "the states' clocks run on",
    "stands": "the states' clocks stand still",
    "simulated": "the states' clocks are the simulation's",
}

_HIDDEN = {"loaded", "entered_ns", "obeyed", "born", "namespace"}  # for llfsm's own processes
_PASSING = {"in_state_s", "error_s", "paused_left_s"}  # count from the message's stamp

SILENT_S = 1.0
"""A process that has posted nothing for so long is gone or stalled."""
PATIENCE_S = 5.0
"""How long people wait for a machine, whose next turn may be that far away."""


class RemoteMachine:
    """A machine that another process runs, as of its latest status: up to a quarter second old."""

    def __init__(self, board: Board, name: str, sample: Sample[MachineStatus], host: str):
        self.name = name
        self._host = host
        self._board = board
        self._sample = sample

    @property
    def status(self) -> MachineStatus:
        """The latest status that its process has published."""
        return self._sample.message

    @property
    def state(self) -> str:
        """The name of its state."""
        return self.status.state

    @property
    def suspended(self) -> bool:
        """True if it is in its suspend state."""
        return self.status.suspended

    @property
    def silent_s(self) -> float:
        """Seconds since its process published the status."""
        return (time.monotonic_ns() - self._sample.stamp_ns) / 1e9

    @property
    def in_state_s(self) -> float:
        """Seconds since it entered its state."""
        return self.status.in_state_s + self.silent_s

    @property
    def condition(self) -> Condition:
        """Its condition, in one word."""
        return condition_of(self.status, self.silent_s)

    def request(self, action: Action) -> Status:
        """Send it a request for its next turn; return its status before.

        As within an arrangement, a resume is refused while a restart is pending.
        """
        requests, pending = self._bound(request_slot(self.name)), self.status.pending
        latest = None if requests is None else requests.get()
        if self.is_asked and latest is not None:
            pending = latest.action
        if action == "resume" and pending == "restart":
            return Status.ERROR
        self.send(MachineRequest(action))
        return Status.SUSPENDED if self.suspended else Status.RUNNING

    def again(self) -> RemoteMachine:
        """Return the machine as of the latest status now."""
        bound = self._bound(status_slot(self.name))
        sample = None if bound is None else bound.sample()
        return RemoteMachine(self._board, self.name, sample or self._sample, self._host)

    def statuses(self, patience_s: float | None = None) -> Iterator[MachineStatus]:
        """Yield its latest status and those that it publishes, until it has ended.

        Raise `TimeoutError` after `patience_s` seconds, by default `PATIENCE_S`.
        """
        patience_s = PATIENCE_S if patience_s is None else patience_s
        until = time.monotonic() + patience_s
        slot = self._bound(status_slot(self.name))
        sample = None if slot is None else slot.sample()
        while slot is not None and sample is not None and is_live(sample, self._host):
            yield sample.message
            left_s = until - time.monotonic()
            if left_s <= 0:
                raise TimeoutError(f"within {patience_s:g} s")
            sample = slot.wait(after=sample.count, timeout=min(left_s, SILENT_S)) or slot.sample()

    @property
    def is_asked(self) -> bool:
        """True if a request is still to be obeyed, as far as that is known.

        The process of another host counts those on its own board.
        """
        is_here = self.status.host == self._host
        requests = self._bound(request_slot(self.name)) if is_here else None
        return requests is not None and requests.count > self.status.obeyed

    def _bound(self, slot: Slot[M]) -> BoundSlot[M] | None:
        """Bind a slot, if it is there: a machine that has ended has given up its names."""
        with suppress(SlotNotFoundError):
            return self._board.present(slot)
        return None

    def renew(self, lease_s: float) -> None:
        """Let a pause last so long from now on, unless another request is still to be obeyed."""
        if not self.is_asked:
            self.send(MachineRequest("renew", lease_s=lease_s))

    def send(self, request: MachineRequest) -> None:
        """Send a request as it is."""
        self._board[request_slot(self.name)].add(request)
        self._board.add_message(BELL, Bell(self.name))


class StatusSlots:
    """The statuses of a board's machines: `bound` as of the last look, by names of slots.

    Looking for one makes no slot, and does not count as reading it.
    """

    def __init__(self, board: Board):
        self._board = board
        self.bound: dict[str, BoundSlot[MachineStatus]] = {}

    def look(self, wants: Callable[[str], bool] = lambda _: True) -> None:
        """Drop the slots that were given up, and bind those new ones whose names it `wants`."""
        listed = [info.name for info in self._board.slots() if info.name.startswith(MACHINES)]
        for name in self.bound.keys() - {*listed}:
            del self.bound[name]
            self._board.forget(status_slot(name.removeprefix(MACHINES)))
        for name in listed:
            if name not in self.bound and wants(name):
                with suppress(SlotError):  # not a machine's status, whatever its name
                    self.bound[name] = self._board.present(status_slot(name.removeprefix(MACHINES)))

    def samples(self) -> Iterator[tuple[str, Sample[MachineStatus]]]:
        """Yield the name and the latest status of each machine, also of those that are gone."""
        for name, slot in self.bound.items():
            with suppress(MessageUnreadableError):
                sample = slot.sample()
                if sample is not None:
                    yield name.removeprefix(MACHINES), sample


class Directory:
    """The machines that all processes run on a board. Looking for one makes no slot there.

    `host` is where it looks from: processes of other hosts cannot be looked up. By default it is
    this host.
    """

    def __init__(self, board: Board, *, host: str = ""):
        self._board = board
        self._host = host or host_name()
        self._slots = StatusSlots(board)

    def find(self, name: str, known: Iterable[str] | None = None) -> RemoteMachine:
        """Return the machine of that name, or raise `UnknownMachineError` naming those there are.

        `known` are the machines of the asking arrangement, if one asks; they are others.
        """
        slot = status_slot(name).name
        if slot not in self._slots.bound:
            self._slots.look()
        bound = self._slots.bound.get(slot)
        sample = None if bound is None else bound.sample()
        if sample is None or not is_live(sample, self._host):
            others = {machine.name for machine in self.machines()} - {*(known or ())}
            if known is None:
                raise UnknownMachineError(name, sorted(others), f"on {self._board.name}")
            raise UnknownMachineError(name, known, elsewhere=sorted(others))
        return RemoteMachine(self._board, name, sample, self._host)

    def machines(self) -> list[RemoteMachine]:
        """Return all of them."""
        return [
            RemoteMachine(self._board, name, sample, self._host)
            for name, sample in self.statuses()
            if is_live(sample, self._host)
        ]

    def statuses(self) -> Iterator[tuple[str, Sample[MachineStatus]]]:
        """Yield the name and the latest status of each machine, also of those that are gone."""
        self._slots.look()
        yield from self._slots.samples()


def condition_of(status: MachineStatus, silent_s: float) -> Condition:
    """Sum up a loaded machine in one word; its status was published `silent_s` seconds ago."""
    if silent_s > SILENT_S:
        return "silent"
    if status.hung:
        return "hung"
    if status.paused:
        return "paused"
    if status.failed:
        return "failed"
    return "suspended" if status.suspended else "running"


def shown_fields(status: MachineStatus) -> dict[str, Any]:
    """Return the fields of a status for people and programs to see, by name.

    Left out are what only llfsm's own processes need, and the times: those go on after the status
    was published, so whoever shows them adds that.
    """
    names = (each for each in status.__struct_fields__ if each not in _HIDDEN | _PASSING)
    return {name: getattr(status, name) for name in names}


def pause_text(status: MachineStatus, silent_s: float = 0.0) -> str:
    """Describe a pause for people: what it does to time, and how it ends, as of a status."""
    clock = _CLOCKS[status.clock]
    if status.paused_left_s is None:
        return f"{clock}; the machines wait until they are continued"
    left_s = max(0.0, status.paused_left_s - silent_s)
    return f"{clock}; the machines continue in {left_s:.0f} s unless the pause is renewed"


def is_live(sample: Sample[MachineStatus], host: str = "") -> bool:
    """Check that a machine is loaded by a process that lives.

    In this PID namespace the process itself is looked up; in another one, as in a container, and on
    another host, a recent status is all there is.
    """
    status = sample.message
    if not status.loaded:
        return False
    recent = time.monotonic_ns() - sample.stamp_ns < SILENT_S * 1e9
    if status.host != (host or host_name()) or status.namespace != pid_namespace():
        return recent
    started = born(status.pid)
    return started == status.born or (recent and started != 0)
