"""An arrangement's machines on its whiteboard: how each is, and what is asked of it from there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, NamedTuple

from llfsm.whiteboard.errors import BoardClosedError, MessageError, WhiteboardError
from llfsm.whiteboard.liveness import born, host_name
from llfsm.whiteboard.messages.llfsm import (
    BELL,
    VIEWER,
    MachineRequest,
    MachineStatus,
    definition_slot,
    request_slot,
    status_slot,
    variables_slot,
)

from ..engine.failure import logger
from ..engine.machine import Machine
from ..journal.handover import Reporter
from .description import definition_of, variables_of
from .remote import is_live

if TYPE_CHECKING:
    from llfsm.whiteboard import Board, BoundSlot

    from ..engine.arrangement import Arrangement
    from ..engine.seat import Arrival

__all__ = ["Presence"]

_PAUSE_NS = 20_000_000  # as often as anybody can look
_BEAT_NS = 250_000_000  # after so long a status is posted again, to tell that it still holds
_VIEW_NS = 2_000_000_000  # for so long after a viewer has told of itself somebody looks
_VARIABLES_NS = 100_000_000


class _Told(NamedTuple):
    """What is worth a message as soon as it changes."""

    state: str
    suspended: bool
    pending: str
    obeyed: int
    entered_ns: int | None


class _Place:
    """Where one machine is told of. The machine of another process may have its name there."""

    def __init__(self, board: Board, name: str, machine: Machine):
        self._board = board
        self._name = name
        self._machine = machine
        self._take()

    def _take(self) -> None:
        """Find a name that no live machine has, as a second machine of an arrangement gets it."""
        names, number = self._name, -1
        while True:
            self._slot = self._board[status_slot(names)]
            sample = self._slot.sample()
            if sample is None or not is_live(sample):
                break
            number += 1
            names = f"{self._name}.{number}"
        self._requests: BoundSlot[MachineRequest] = self._board[request_slot(names)]
        self.obeyed = self._requests.count  # those were for somebody before us
        self._count = 0
        self.told: _Told | None = None
        self.beat_ns = 0
        self._variables = variables_slot(names)
        self._define(names)

    def _define(self, names: str) -> None:
        """Post what it consists of; without its code, if that is too much or no text at all."""
        for sections in (True, False):
            definition = definition_of(type(self._machine).table, sections=sections)
            with suppress(MessageError):
                self._board[definition_slot(names)].add(definition)
                return

    def tell_variables(self) -> None:
        """Post the machine's variables, if it has any."""
        if type(self._machine).table.variables:
            self._board[self._variables].add(variables_of(self._machine))

    def keep_name(self) -> None:
        """Find another name if somebody else has had the same idea about this one."""
        if self._count and self._slot.count != self._count:
            sample = self._slot.sample()
            if sample is not None and is_live(sample):
                self._take()

    def post(self, told: _Told, status: MachineStatus, now_ns: int) -> None:
        """Post the status."""
        self._count = self._slot.add(status)
        self.told, self.beat_ns = told, now_ns

    def request(self) -> str | None:
        """Return what is asked for since the last call: the latest only, as it replaces others."""
        sample = self._requests.sample()
        if sample is None or sample.count == self.obeyed:
            return None
        self.obeyed = sample.count
        return sample.message.action

    def leave(self) -> None:
        """Post that the machine is gone."""
        if self.told is not None and self._slot.count == self._count:
            self._slot.add(MachineStatus(self.told.state, loaded=False))


class Presence:
    """Tell of an arrangement's machines on a board, and obey what is asked of them there.

    It is asked after every round, and while the arrangement sleeps. As long as round follows round
    without a sleep it posts only fifty times a second, so that a fast arrangement stays fast.
    """

    def __init__(self, arrangement: Arrangement, board: Board) -> None:
        self._arrangement = arrangement
        self._board = board
        self._pid = os.getpid()
        self._born = born(self._pid)
        self._places: dict[str, _Place] = {}
        self._bell = board[BELL]
        self._heard = self._bell.count
        self._viewer = board[VIEWER]
        self._viewed = self._viewer.count
        self._view_ends_ns = self._variables_due_ns = self._arrangement.clock.now_ns()
        self._reporter = Reporter(arrangement, board)
        self._due_ns = 0
        self._works = True
        self.look(idle=True)

    def look(self, *, idle: bool) -> None:
        """Do what is asked for; then post what has changed, if there is time or it is due."""
        self.hear()
        now_ns = self._arrangement.clock.now_ns()
        if idle or now_ns >= self._due_ns:
            self._due_ns = now_ns + _PAUSE_NS
            if self._works:
                with self._whatever_happens():
                    self._post(now_ns)
            self._reporter.look()

    def hear(self) -> None:
        """Do what is asked for."""
        with suppress(BoardClosedError):  # which stops the arrangement, when it looks
            heard = self._bell.count
            if heard != self._heard:
                self._heard = heard
                self._obey()

    def end(self) -> None:
        """Post that the machines are gone."""
        with self._whatever_happens():
            for place in self._places.values():
                place.leave()
        self._places.clear()

    @contextmanager
    def _whatever_happens(self) -> Iterator[None]:
        """Let no board that is full, or not ours to write to, stop a robot: say so, once."""
        try:
            yield
        except BoardClosedError:  # which stops the arrangement, when it looks
            pass
        except WhiteboardError as error:
            self._works = False
            logger().warning("machines cannot be told of on the whiteboard: %s", error)

    def _obey(self) -> None:
        obey = {
            "suspend": self._arrangement.hold,
            "resume": self._arrangement.resume,
            "restart": self._arrangement.restart,
            "stop": self._arrangement.stop_machine,
        }
        for standing in self._arrangement.standings():
            place = None if standing is None else self._places.get(standing.machine)
            action = None if place is None else place.request()
            if action is not None and standing is not None:
                obey[action](standing.machine)

    def _post(self, now_ns: int) -> None:
        left = set(self._places)
        for standing in self._arrangement.standings():
            if standing is None:
                continue
            left.discard(standing.machine)
            place = self._places.get(standing.machine)
            if place is None:
                place = self._places[standing.machine] = _Place(
                    self._board, standing.machine, self._arrangement.machine(standing.machine)
                )
            arrival = self._arrangement.arrival(standing.machine)
            told = _Told(
                standing.state,
                standing.suspended,
                standing.request or "",
                place.obeyed,
                arrival.entered_ns,
            )
            if told != place.told or now_ns - place.beat_ns >= _BEAT_NS:
                place.keep_name()
                told = told._replace(obeyed=place.obeyed)
                place.post(told, self._status(standing.machine, told, arrival, now_ns), now_ns)
        for name in left:
            self._places.pop(name).leave()
        self._tell_variables(now_ns)

    def _tell_variables(self, now_ns: int) -> None:
        if self._viewer.count != self._viewed:
            self._viewed = self._viewer.count
            self._view_ends_ns = now_ns + _VIEW_NS
        if self._variables_due_ns <= now_ns < self._view_ends_ns:
            self._variables_due_ns = now_ns + _VARIABLES_NS
            for place in self._places.values():
                place.tell_variables()

    def _status(self, name: str, told: _Told, arrival: Arrival, now_ns: int) -> MachineStatus:
        ringlets, overruns = self._arrangement.progress(name)
        entered_ns = now_ns if told.entered_ns is None else told.entered_ns
        return MachineStatus(
            state=told.state,
            suspended=told.suspended,
            pending=told.pending,
            ringlets=ringlets,
            overruns=overruns,
            in_state_s=(now_ns - entered_ns) / 1e9,
            source=arrival.source,
            transition=arrival.transition,
            entered_ns=told.entered_ns or 0,
            obeyed=told.obeyed,
            pid=self._pid,
            born=self._born,
            host=host_name(),
        )
