"""An arrangement's machines on its whiteboard: their statuses out, requests to them in."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from llfsm.whiteboard.errors import (
    BoardClosedError,
    WhiteboardError,
)
from llfsm.whiteboard.liveness import born, host_name, is_local, pid_namespace, process_text
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.llfsm import (
    BELL,
    MACHINES,
    VIEWER,
    Bell,
    MachineStatus,
    status_slot,
)

from ..engine.errors import UnknownMachineError
from ..engine.failure import logger, one_line
from ..journal.handover import Handover, Reporter
from .commanders import Claims
from .published import Published, PublishedMachine
from .remote import Directory

if TYPE_CHECKING:
    from llfsm.whiteboard import Board

    from ..engine.arrangement import Arrangement
    from ..engine.clock import Clock
    from ..engine.seat import Arrival

__all__ = ["Presence"]

_PAUSE_NS = 20_000_000  # between two posts; a viewer does not look more often
_BEAT_NS = 250_000_000  # a status that still holds is posted again after so long
_VIEW_NS = 2_000_000_000  # a viewer that has posted its presence looks for so long
_VARIABLES_NS = 100_000_000


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
        self._entries: dict[str, PublishedMachine] = {}
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
        self._hidden: set[str] = set()  # machines that cannot be published
        self._has_warned = False
        self._lock = threading.Lock()  # a watchdog posts, too
        self.look(idle=True)

    @property
    def reachable(self) -> bool:
        """Whether another process can resume one of the machines that have failed."""
        published = self._entries.keys() - self._hidden
        can_be = not published.isdisjoint(self._arrangement.failed_machines)
        return can_be and not isinstance(self._board, LocalBoard)

    def look(self, *, idle: bool) -> None:
        """Obey requests; then post what has changed, if there is time (`idle`) or it is due."""
        self.obey()
        now_ns = self._now()
        if idle or now_ns >= self._due_ns:
            self._due_ns = now_ns + _PAUSE_NS
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
        with self._lock, self._tolerating_the_board(), self._publishing(name):
            self._add(name)

    def publish_hang(self, name: str) -> None:
        """Post the status of a machine whose code hangs; called by the watchdog's thread."""
        with self._lock, self._tolerating_the_board(), suppress(UnknownMachineError):  # it has left
            entry = None if name in self._hidden else self._entries.get(name)
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
            if not self._has_warned:
                self._has_warned = True
                logger().warning("not all can be published on the whiteboard: %s", error)

    @contextmanager
    def _publishing(self, name: str) -> Iterator[None]:
        """Log once that a machine cannot be published, and do not try it again; others can be."""
        try:
            yield
        except BoardClosedError:
            raise
        except WhiteboardError as error:
            self._hidden.add(name)
            logger().warning("%s cannot be published on the whiteboard: %s", name, error)

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
            self._hidden &= marks.keys()
            for name in self._entries.keys() - marks:
                self._namesakes.pop(name, None)
                self._entries.pop(name).leave()
            for name, mark in marks.items():
                if name not in self._hidden:
                    with self._publishing(name):
                        entry = self._entries.get(name) or self._add(name)
                        if mark != self._marks.get(name) or now_ns - entry.beat_ns >= _BEAT_NS:
                            self._describe(entry, now_ns)
            self._marks = marks
            shown = self._entries.keys() - self._hidden
            beats = [self._entries[name].beat_ns for name in shown]
            self._beat_due_ns = min(beats, default=now_ns) + _BEAT_NS
        self._post_variables(now_ns)

    def _describe(self, entry: PublishedMachine, now_ns: int) -> None:
        standing = self._arrangement.standing(entry.name)
        arrival = self._arrangement.arrival(entry.name)
        latest = Published(
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

    def _add(self, name: str) -> PublishedMachine:
        entry = self._entries[name] = PublishedMachine(
            self._board,
            name,
            self._arrangement.machine(name),
            self._arrangement.safe_values(name),
            self._will_after_ms,
        )
        return entry

    def _report_name(self, entry: PublishedMachine) -> None:
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
                with self._tolerating_the_board():
                    entry.post_variables()

    def _status(self, name: str, latest: Published, arrival: Arrival, now_ns: int) -> MachineStatus:
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
