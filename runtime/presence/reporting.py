"""An arrangement's machines on its whiteboard: their statuses out, requests to them in."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, NamedTuple

from llfsm.whiteboard.errors import BoardClosedError, MessageError, WhiteboardError
from llfsm.whiteboard.liveness import born, host_name, is_local, pid_namespace, process_text
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.llfsm import (
    BELL,
    MACHINES,
    VIEWER,
    Bell,
    MachineRequest,
    MachineStatus,
    definition_slot,
    request_slot,
    status_slot,
    variables_slot,
)

from ..engine.errors import UnknownMachineError
from ..engine.failure import logger, one_line
from ..engine.machine import Machine
from ..journal.handover import Handover, Reporter
from .commanders import Claims
from .description import definition_of, variables_of
from .remote import Directory, is_live
from .will import Will

if TYPE_CHECKING:
    from llfsm.whiteboard import Board, BoundSlot, Message, Slot

    from ..engine.arrangement import Arrangement
    from ..engine.clock import Clock
    from ..engine.seat import Arrival, Failure

__all__ = ["Presence"]

_PAUSE_NS = 20_000_000  # between two posts; a viewer does not look more often
_BEAT_NS = 250_000_000  # a status that still holds is posted again after so long
_VIEW_NS = 2_000_000_000  # a viewer that has posted its presence looks for so long
_VARIABLES_NS = 100_000_000


class _Published(NamedTuple):
    """The part of a status that is posted as soon as it changes."""

    state: str
    suspended: bool
    pending: str
    obeyed: int
    entered_ns: int | None
    failure: Failure | None
    hang: str


class _Entry:
    """The slots of one machine. The machine of another process may have its name there."""

    def __init__(
        self,
        board: Board,
        name: str,
        machine: Machine,
        safe_values: list[tuple[Slot[Any], Message]],
        silent_ms: int,
    ):
        self._board = board
        self._machine = machine
        self._safe_values = safe_values
        self._silent_ms = silent_ms
        self.name = self.published_name = name
        self.namesake: MachineStatus | None = None  # of the live machine that has the name
        self._will: Will | None = None
        self._take()

    def _take(self) -> None:
        """Claim a name that no live machine has: `P`, else `P.0`, `P.1` …, as in an arrangement."""
        names, number = self.name, -1
        while True:
            self._slot = self._board[status_slot(names)]
            sample = self._slot.sample()
            if sample is None or not is_live(sample):
                break
            self.namesake = self.namesake or sample.message
            number += 1
            names = f"{self.name}.{number}"
        self.published_name = names
        if self._will is not None:  # under the name that another process has claimed, too
            self._will.withdraw()
        self._will = None
        if self._safe_values:
            self._will = Will(self._board, names, self._safe_values, self._silent_ms)
            self._will.leave()
        self._requests: BoundSlot[MachineRequest] = self._board[request_slot(names)]
        self.obeyed = self._requests.count  # those were for an earlier process
        self._count = 0
        self.published: _Published | None = None
        self.beat_ns = 0
        self._variables = variables_slot(names)
        self._define(names)

    def _define(self, names: str) -> None:
        """Post the definition; without code if that is too large or not text."""
        for sections in (True, False):
            definition = definition_of(type(self._machine).table, sections=sections)
            with suppress(MessageError):
                self._board[definition_slot(names)].add(definition)
                return

    def post_variables(self) -> None:
        """Post the machine's variables, if it has any."""
        if type(self._machine).table.variables:
            self._board[self._variables].add(variables_of(self._machine))

    def keep(self) -> None:
        """Keep the name, or claim another one if another process claimed it at the same moment.

        Leave the last will again if a guard has executed it.
        """
        if self._count and self._slot.count != self._count:
            sample = self._slot.sample()
            if sample is not None and is_live(sample):
                self._take()
        if self._will is not None:
            self._will.keep()

    def post(self, published: _Published, status: MachineStatus, now_ns: int) -> None:
        """Post the status."""
        self._count = self._slot.add(status)
        self.published, self.beat_ns = published, now_ns

    def request(self) -> str | None:
        """Return the request that came since the last call: the latest replaces the others."""
        sample = self._requests.sample()
        if sample is None or sample.count == self.obeyed:
            return None
        self.obeyed = sample.count
        return sample.message.action

    def leave(self) -> None:
        """Post that the machine is gone."""
        if self._will is not None:
            self._will.withdraw()
        if self.published is not None and self._slot.count == self._count:
            self._slot.add(MachineStatus(self.published.state, loaded=False))


class Presence:
    """Publish the statuses of an arrangement's machines on a board, and obey requests made there.

    The arrangement calls it after every round and while it sleeps. As long as rounds follow each
    other without a sleep it posts only fifty times a second, so that a fast arrangement stays fast.
    """

    def __init__(
        self,
        arrangement: Arrangement,
        board: Board,
        handover: Handover | None = None,
        clock: Clock | None = None,
        will_after_ms: int = 0,
        claims: Claims | None = None,
    ) -> None:
        self._arrangement = arrangement
        self._will_after_ms = will_after_ms
        self._claims = claims or Claims(board)
        self._now = (clock or arrangement.clock).now_ns
        self._board = board
        self._pid = os.getpid()
        self._born = born(self._pid)
        self._entries: dict[str, _Entry] = {}
        self._marks: dict[str, tuple[object, ...]] = {}  # of the machines as last published
        self._beat_due_ns = 0  # when the first of them is to be published again
        self._bell = board[BELL]
        self._rung = self._bell.count
        self._has_rung = False  # since namesakes were looked for
        self._namesakes: dict[str, str] = {}  # published names that were logged, by machine
        self._logged: set[tuple[str, int]] = set()  # names and processes of others' namesakes
        self._viewer = board[VIEWER]
        self._viewed = self._viewer.count
        self._view_ends_ns = self._variables_due_ns = self._now()
        self._reporter = Reporter(arrangement, board, handover)
        self._due_ns = 0
        self._works = True
        self._lock = threading.Lock()  # a watchdog posts, too
        self.look(idle=True)

    @property
    def reachable(self) -> bool:
        """Whether the machines are published on a board that other processes have, too."""
        return self._works and not isinstance(self._board, LocalBoard)

    def look(self, *, idle: bool) -> None:
        """Obey requests; then post what has changed, if there is time (`idle`) or it is due."""
        self.obey()
        now_ns = self._now()
        if idle or now_ns >= self._due_ns:
            self._due_ns = now_ns + _PAUSE_NS
            if self._works:
                with self._lock, self._tolerating_the_board():
                    self._post(now_ns)
                    self._claims.look()
                    if self._has_rung:
                        self._report_namesakes()
            self._reporter.look()

    def obey(self) -> None:
        """Obey the requests that have come."""
        try:
            rung = self._bell.count
            if rung != self._rung:
                self._rung = rung
                self._has_rung = True
                self._obey_all()
        except BoardClosedError:  # which stops the arrangement, when it looks
            pass

    def add(self, name: str) -> None:
        """Claim the slots of a machine that was loaded."""
        if self._works:
            with self._lock, self._tolerating_the_board():
                self._add(name)

    def publish_hang(self, name: str) -> None:
        """Post the status of a machine whose code hangs; called by the watchdog's thread."""
        with self._lock, self._tolerating_the_board(), suppress(UnknownMachineError):  # it has left
            entry = self._entries.get(name)
            if entry is not None and entry.published is not None:
                now_ns = self._now()
                latest = entry.published._replace(hang=self._arrangement.hang(name))
                arrival = self._arrangement.arrival(name)
                entry.post(latest, self._status(name, latest, arrival, now_ns), now_ns)
                self._marks.pop(name, None)  # it may look the same again when it has returned

    def end(self) -> None:
        """Post that the machines are gone."""
        with self._tolerating_the_board():
            for entry in self._entries.values():
                entry.leave()
        self._entries.clear()

    @contextmanager
    def _tolerating_the_board(self) -> Iterator[None]:
        """Log once that the board is full or read-only: it must not stop a robot."""
        try:
            yield
        except BoardClosedError:  # which stops the arrangement, when it looks
            pass
        except WhiteboardError as error:
            self._works = False
            logger().warning("machines cannot be published on the whiteboard: %s", error)

    def _obey_all(self) -> None:
        obey = {
            "suspend": self._arrangement.hold,
            "resume": self._arrangement.resume,
            "restart": self._arrangement.restart,
            "stop": self._arrangement.stop_machine,
        }
        for standing in self._arrangement.standings():
            entry = None if standing is None else self._entries.get(standing.machine)
            action = None if entry is None else entry.request()
            if action is not None and standing is not None:
                obey[action](standing.machine)
                self._marks.pop(standing.machine, None)  # the count of requests has changed
                self._arrangement.environment.wake()

    def _post(self, now_ns: int) -> None:
        marks = self._arrangement.marks()
        if marks != self._marks or now_ns >= self._beat_due_ns:
            for name in self._entries.keys() - marks:
                self._entries.pop(name).leave()
                self._namesakes.pop(name, None)
            for name, mark in marks.items():
                entry = self._entries.get(name) or self._add(name)
                if mark != self._marks.get(name) or now_ns - entry.beat_ns >= _BEAT_NS:
                    self._describe(entry, now_ns)
            self._marks = marks
            beats = [entry.beat_ns for entry in self._entries.values()]
            self._beat_due_ns = min(beats, default=now_ns) + _BEAT_NS
        self._post_variables(now_ns)

    def _describe(self, entry: _Entry, now_ns: int) -> None:
        standing = self._arrangement.standing(entry.name)
        arrival = self._arrangement.arrival(entry.name)
        latest = _Published(
            standing.state,
            standing.suspended,
            standing.request or "",
            entry.obeyed,
            arrival.entered_ns,
            self._arrangement.failure(entry.name),
            self._arrangement.hang(entry.name),
        )
        if latest != entry.published or now_ns - entry.beat_ns >= _BEAT_NS:
            entry.keep()
            latest = latest._replace(obeyed=entry.obeyed)
            entry.post(latest, self._status(entry.name, latest, arrival, now_ns), now_ns)
            if entry.published_name != self._namesakes.get(entry.name, entry.name):
                self._report_name(entry)

    def _add(self, name: str) -> _Entry:
        entry = self._entries[name] = _Entry(
            self._board,
            name,
            self._arrangement.machine(name),
            self._arrangement.safe_values(name),
            self._will_after_ms,
        )
        return entry

    def _report_name(self, entry: _Entry) -> None:
        """Log that a machine has another name on the board, and let the namesake look for it."""
        self._namesakes[entry.name] = entry.published_name
        if entry.namesake is not None:
            logger().warning(
                "%s runs a machine %s on this whiteboard, too; this one is published as %s",
                _process(entry.namesake),
                entry.name,
                entry.published_name,
            )
        self._claims.rename(entry.name, entry.published_name)
        self._bell.add(Bell(entry.name))

    def _report_namesakes(self) -> None:
        """Log, once each, machines of other processes that have the name of one of these."""
        self._has_rung = False
        for machine in Directory(self._board).machines():
            status = machine.status
            ours = status.pid == self._pid and is_local(status)
            number = re.search(r"\.\d+$", machine.name)
            if ours or number is None or (machine.name, status.pid) in self._logged:
                continue
            name = machine.name[: number.start()]
            if name in (status_slot(each).name.removeprefix(MACHINES) for each in self._entries):
                self._logged.add((machine.name, status.pid))
                logger().warning(
                    "%s runs a machine %s on this whiteboard, too; it is published as %s",
                    _process(status),
                    name,
                    machine.name,
                )

    def _post_variables(self, now_ns: int) -> None:
        if self._viewer.count != self._viewed:
            self._viewed = self._viewer.count
            self._view_ends_ns = now_ns + _VIEW_NS
        if self._variables_due_ns <= now_ns < self._view_ends_ns:
            self._variables_due_ns = now_ns + _VARIABLES_NS
            for entry in self._entries.values():
                entry.post_variables()

    def _status(
        self, name: str, latest: _Published, arrival: Arrival, now_ns: int
    ) -> MachineStatus:
        ringlets, overruns = self._arrangement.progress(name)
        entered_ns = now_ns if latest.entered_ns is None else latest.entered_ns
        return MachineStatus(
            state=latest.state,
            suspended=latest.suspended,
            pending=latest.pending,
            ringlets=ringlets,
            overruns=overruns,
            in_state_s=(now_ns - entered_ns) / 1e9,
            source=arrival.source,
            transition=arrival.transition,
            entered_ns=latest.entered_ns or 0,
            obeyed=latest.obeyed,
            pid=self._pid,
            born=self._born,
            host=host_name(),
            failed=latest.failure is not None,
            namespace=pid_namespace(),
            hung=bool(latest.hang),
            realtime=self._arrangement.realtime or 0,
            cpu=-1 if self._arrangement.cpu is None else self._arrangement.cpu,
            error=latest.hang or ("" if latest.failure is None else one_line(latest.failure.error)),
            error_state="" if latest.failure is None else latest.failure.error.state,
            error_s=0.0 if latest.failure is None else (now_ns - latest.failure.time_ns) / 1e9,
        )


def _process(status: MachineStatus) -> str:
    return process_text(status).replace("pid", "process", 1)
