"""An arrangement's machines on its whiteboard: their statuses out, requests to them in.

A status is posted when a machine changes where it stands, and four times a second at least. To
find out costs a comparison of a few objects (`_marks`); only then is a `MachineStatus` made, whose
fields are filled here and nowhere else. While rounds follow each other without a sleep, posts are
20 ms apart, so that a fast arrangement stays fast; nothing waits for a reader.

Requests come the other way: whoever makes one rings the board's bell, which costs a comparison of
counts to look at. Suspend, resume, restart and stop go to the arrangement's control, the debugger's
to a debugger that is made then, and a reload to `Reloads`, which loads the bundle in a thread.
"""

from __future__ import annotations

import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import replace

from llfsm.errors import LlfsmError, one_line
from llfsm.runtime.bundles import SUFFIX
from llfsm.runtime.checking.bundles import load_checked
from llfsm.runtime.engine.errors import LoadError, UnknownMachineError
from llfsm.runtime.engine.ringlet import marks_of
from llfsm.runtime.journal.handover import Handover, Reporter
from llfsm.runtime.log import logger
from llfsm.runtime.presence.published import PublishedMachine, Viewing, vacate_dead
from llfsm.runtime.presence.remote import Directory
from llfsm.runtime.presence.slot_ownership import Claims
from llfsm.whiteboard.errors import BoardClosedError, WhiteboardError
from llfsm.whiteboard.liveness import born, host_name, is_local, pid_namespace, process_text
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.llfsm import (
    BELL,
    MACHINES,
    Bell,
    MachineRequest,
    MachineStatus,
    OverriddenSensor,
    status_slot,
)

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.clock import Clock
    from llfsm.runtime.engine.machine import Machine
    from llfsm.runtime.engine.seat import Seat
    from llfsm.whiteboard import Board


class NameConflicts:
    """Log, once each, machines of several processes that have one name on a board.

    The second one is published under another name.
    """

    def __init__(self, board: Board, claims: Claims):
        self._board = board
        self._claims = claims
        self._published: dict[str, str] = {}  # names that were logged, by machine
        self._logged: set[tuple[str, int]] = set()  # names and processes of others' machines

    def forget(self, machine: str) -> None:
        """Note that a machine is gone."""
        self._published.pop(machine, None)

    def look_at(self, entry: PublishedMachine) -> None:
        """Log if a machine has another name on the board, and notify the one that has its name."""
        if entry.published_name == self._published.get(entry.name, entry.name):
            return
        self._published[entry.name] = entry.published_name
        if entry.rival is not None:
            logger().warning(
                "%s runs a machine %s on this whiteboard, too; this one is published as %s",
                process_text(entry.rival, "process"),
                entry.name,
                entry.published_name,
            )
        self._claims.rename(entry.name, entry.published_name)
        self._board.add_message(BELL, Bell(entry.name))

    def report(self, ours: Iterable[str]) -> None:
        """Log machines of other processes that have the name of one of `ours`."""
        names = {status_slot(each).name.removeprefix(MACHINES) for each in ours}
        for machine in Directory(self._board).machines():
            status = machine.status
            own = status.pid == os.getpid() and is_local(status)
            number = re.search(r"\.\d+$", machine.name)
            if own or number is None or (machine.name, status.pid) in self._logged:
                continue
            name = machine.name[: number.start()]
            if name in names:
                self._logged.add((machine.name, status.pid))
                logger().warning(
                    "%s runs a machine %s on this whiteboard, too; it is published as %s",
                    process_text(status, "process"),
                    name,
                    machine.name,
                )


_PAUSE_NS = 20_000_000  # between two posts; a viewer does not look more often
_BEAT_NS = 250_000_000  # a status that still holds is posted again after so long


class _Tolerance:
    """Log once that the board is full or read-only: it must not stop a robot.

    It is a class, because a generator would cost a machine that waits a tenth of all its time.
    """

    def __init__(self) -> None:
        self._has_warned = False

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> bool:
        if not isinstance(error, WhiteboardError):
            return False
        # A closed board stops the arrangement, when it looks.
        if not self._has_warned and not isinstance(error, BoardClosedError):
            self._has_warned = True
            logger().warning("not all can be published on the whiteboard: %s", error)
        return True


class StatusPublisher:
    """Publish the statuses of an arrangement's machines on a board, and obey requests made there.

    It attends to the run: the arrangement calls it after every round and while it sleeps.
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
        self._kernel = arrangement.kernel
        self._roster = arrangement.roster
        self._will_after_ms = will_after_ms
        self._claims = claims or Claims(board)
        vacate_dead(board)
        clock = clock or arrangement.clock
        self._while_paused = clock.while_paused
        self._now = clock.of_statuses().now_ns
        self._machine_now = clock.now_ns
        self._board = board
        self._pid = os.getpid()
        self._born = born(self._pid)
        self._entries: dict[str, PublishedMachine] = {}
        self._marks: dict[str, tuple[object, ...]] = {}  # of the machines as last published
        self._beat_due_ns = 0  # when the first of them is to be published again
        self._bell = board[BELL]
        self._rung = self._bell.count
        self._has_rung = False  # since name conflicts were looked for
        self._conflicts = NameConflicts(board, self._claims)
        self._reloads = Reloads(arrangement)
        self._reporter = Reporter(arrangement, board, handover)
        self._due_ns = 0
        self._beaten_ns = 0  # when all statuses were posted, though time may stand still
        self._hidden: set[str] = set()  # machines that cannot be published
        self._tolerating_the_board = _Tolerance()
        self._viewing = Viewing(
            arrangement, board, self._now(), clock.now_ns, self._tolerating_the_board
        )
        self._lock = threading.Lock()  # a watchdog posts, too
        self.look(idle=True)

    @property
    def reachable(self) -> bool:
        """True if another process can resume one of the machines that have failed."""
        published = self._entries.keys() - self._hidden
        can_be = not published.isdisjoint(self._roster.failed)
        return can_be and not isinstance(self._board, LocalBoard)

    @property
    def due_ns(self) -> int:
        """When a status is to be posted again, or variables are."""
        viewed_ns = self._viewing.due_ns
        return self._beat_due_ns if viewed_ns is None else min(self._beat_due_ns, viewed_ns)

    def publishes(self, name: str) -> bool:
        """Check that a machine's status is published, also if it has left since the last look."""
        return name in self._entries

    def look(self, *, idle: bool) -> None:
        """Obey requests; then post what has changed, if there is time (`idle`) or it is due."""
        self.obey()
        now_ns = self._now()
        if now_ns >= self._due_ns or (idle and self._has_news(now_ns)):
            self._due_ns = now_ns + _PAUSE_NS
            self._look_at_instrument()
            self._reload()
            with self._lock, self._tolerating_the_board:
                self._post(now_ns)
                self._claims.look()
                if self._has_rung:
                    self._has_rung = False
                    self._conflicts.report(self._entries)
            self._reporter.look()

    def beat(self) -> None:
        """Obey requests, and post what has changed; four times a second post all."""
        self.obey()
        now_ns, host_ns = self._now(), time.monotonic_ns()
        is_due = host_ns - self._beaten_ns >= _BEAT_NS
        if is_due:
            self._look_at_instrument()
            self._beaten_ns = host_ns
            self._beat_due_ns = now_ns
            self._viewing.hurry(now_ns)
            self._marks = {}
            for entry in self._entries.values():
                entry.beat_ns = now_ns - _BEAT_NS
        if is_due or self._current_marks() != self._marks:
            with self._lock, self._tolerating_the_board:
                self._post(now_ns)
            self._reporter.look()

    def obey(self) -> bool:
        """Obey the requests that have come, and return whether any may have."""
        try:
            rung = self._bell.count
            if rung == self._rung:
                return False
            self._rung = rung
            self._has_rung = True
            self._obey_all()
        except BoardClosedError:  # which stops the arrangement, when it looks
            pass
        return True

    def add(self, name: str) -> None:
        """Claim the slots of a machine that was loaded."""
        with self._lock, self._tolerating_the_board, self._publishing(name):
            self._add(name)

    def publish_hang(self, name: str) -> None:
        """Post the status of a machine whose code hangs; called by the watchdog's thread."""
        with self._lock, self._tolerating_the_board, suppress(UnknownMachineError):  # it has left
            entry = None if name in self._hidden else self._entries.get(name)
            if entry is not None and entry.published is not None:
                # A turn is under way: the rest is as it was before that.
                before, seat = entry.published, self._roster.find(name)
                entered_ns = before.entered_ns or self._machine_now()
                in_state_s = (self._machine_now() - entered_ns) / 1e9
                hangs = replace(before, hung=True, error=seat.hang, in_state_s=in_state_s)
                entry.post(hangs, self._now())
                self._marks.pop(name, None)  # it may look the same again when it has returned
                self._arrangement.environment.wake()

    def end(self) -> None:
        """Post that the machines are gone."""
        with self._tolerating_the_board:
            failures = {seat.name: seat.failure for seat in self._roster}
            for name, entry in self._entries.items():
                entry.leave(failures.get(name))
        self._entries.clear()

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
            "suspend": self._arrangement.control.hold,
            "resume": self._arrangement.resume,
            "restart": self._arrangement.restart,
            "stop": self._arrangement.stop_machine,
        }
        for name in [seat.name for seat in self._roster]:
            entry = self._entries.get(name)
            request = None if entry is None else entry.request()
            if request is not None:
                if request.action == "reload":
                    self._reloads.begin(name)
                elif request.action in obey:
                    self._reloads.cancel(name)
                    obey[request.action](name)
                else:
                    self._debug(request, name)
                # The count of requests has changed; if the machine ends by it, that is seen, too.
                self._marks[name] = ()
                self._arrangement.environment.wake()

    def _reload(self) -> None:
        """Exchange the machines whose bundles are loaded, and publish what they are now."""
        for name in self._reloads.finish():
            self._marks.pop(name, None)
            entry = self._entries.get(name)
            if entry is not None and name not in self._hidden:
                with self._lock, self._tolerating_the_board, self._publishing(name):
                    seat = self._roster.find(name)
                    entry.exchange(seat.machine, seat.safe_values())

    def _debug(self, request: MachineRequest, machine: str) -> None:
        """Have a debugger do what is requested."""
        from llfsm.runtime.debugging.debugger import Debugger  # here, because few ask
        from llfsm.runtime.debugging.obeying import obey

        obey(Debugger.of(self._arrangement), request, machine)

    def _look_at_instrument(self) -> None:
        if self._kernel.instrument is not None:
            self._kernel.instrument.look()

    def _has_news(self, now_ns: int) -> bool:
        is_due = now_ns >= self._beat_due_ns or self._reloads.is_ready
        return is_due or self._current_marks() != self._marks

    def _post(self, now_ns: int) -> None:
        marks = self._current_marks()
        if marks != self._marks or now_ns >= self._beat_due_ns:
            self._hidden &= marks.keys()
            for name in self._entries.keys() - marks:
                self._conflicts.forget(name)
                self._entries.pop(name).leave()
            for name, mark in marks.items():
                if name not in self._hidden:
                    with self._publishing(name):
                        entry = self._entries.get(name) or self._add(name)
                        is_same = mark == self._marks.get(name)
                        if not is_same or now_ns - entry.beat_ns >= _BEAT_NS:
                            entry.keep()
                            entry.post(self._status(entry), now_ns)
                            self._conflicts.look_at(entry)
            self._marks = marks
            shown = self._entries.keys() - self._hidden
            beats = [self._entries[name].beat_ns for name in shown]
            self._beat_due_ns = min(beats, default=now_ns) + _BEAT_NS
        self._viewing.look(self._entries.values(), now_ns)

    def _current_marks(self) -> dict[str, tuple[object, ...]]:
        """Collect, by machine, the objects that change with its status, without what counts."""
        return {
            seat.name: (*marks_of(seat), self._kernel.paused, seat.overridden, seat.called_by)
            for seat in self._roster
        }

    def _overridden(self, seat: Seat, sensor: str) -> OverriddenSensor:
        instrument = self._kernel.instrument
        left_s = None if instrument is None else instrument.left_s(seat.name, sensor)
        return OverriddenSensor(sensor, left_s)

    def _add(self, name: str) -> PublishedMachine:
        seat = self._roster.find(name)
        if name in self._entries:  # of one that has just ended
            self._entries.pop(name).leave()
        entry = self._entries[name] = PublishedMachine(
            self._board, name, seat.machine, seat.safe_values(), self._will_after_ms
        )
        return entry

    def _status(self, entry: PublishedMachine) -> MachineStatus:
        seat, now_ns = self._roster.find(entry.name), self._machine_now()
        standing, arrival, failure = seat.standing(), seat.arrival(), seat.failure
        ringlets, overruns = seat.progress
        priority, cpu = self._kernel.achieved
        paused, instrument, error = self._kernel.paused, self._kernel.instrument, seat.hang
        caller = self._entries.get(seat.called_by)
        if failure is not None and not error:
            error = one_line(failure.error)
        is_reloading = self._reloads.is_pending(seat.name)
        entered_ns = now_ns if arrival.entered_ns is None else arrival.entered_ns
        return MachineStatus(
            state=standing.state,
            suspended=standing.suspended,
            pending="reload" if is_reloading else standing.request or "",
            ringlets=ringlets,
            overruns=overruns,
            in_state_s=(now_ns - entered_ns) / 1e9,
            source=arrival.source,
            transition=arrival.transition,
            entered_ns=arrival.entered_ns or 0,
            obeyed=entry.obeyed,
            pid=self._pid,
            born=self._born,
            host=host_name(),
            failed=failure is not None,
            namespace=pid_namespace(),
            hung=bool(seat.hang),
            paused=paused,
            overridden=tuple(self._overridden(seat, sensor) for sensor in seat.overridden),
            caller=seat.called_by if caller is None else caller.published_name,
            refusal=self._reloads.refusal(seat.name),
            paused_left_s=instrument.pause_left_s() if paused and instrument else None,
            clock=self._while_paused,
            realtime=priority or 0,
            cpu=-1 if cpu is None else cpu,
            error=error,
            error_state="" if failure is None else failure.error.state,
            error_s=0.0 if failure is None else (now_ns - failure.time_ns) / 1e9,
            waits=seat.waits_for,
        )


class Reloads:
    """Machines of an arrangement that are to restart from the current versions of their bundles.

    Each bundle is read from the folder from which it was loaded, and checked, in a thread. The
    machine takes its turns meanwhile, and goes on as it is if the bundle has an error.
    """

    def __init__(self, arrangement: Arrangement):
        self._arrangement = arrangement
        self._loading: dict[str, _Loading] = {}
        self._refusals: dict[str, str] = {}

    def begin(self, name: str) -> None:
        """Load the bundle of a machine again, or note why that is refused."""
        self._refusals.pop(name, None)
        before = self._loading.get(name)
        if before is not None and not before.is_done:
            self._refuse(name, "its bundle is still being loaded, as was asked before")
            return
        path = type(self._arrangement.machine(name)).table.path
        try:
            self._arrangement.environment.requested("reload", name)
            if Path(path).suffix != SUFFIX:
                raise LoadError(
                    f"{path} is a class, and only a {SUFFIX} bundle can be reloaded: "
                    f"end its process and run it again"
                )
        except LoadError as error:
            self._refuse(name, str(error))
            return
        suspended = self._arrangement.is_suspended(name)
        self._loading[name] = _Loading(path, suspended, self._arrangement.environment.wake)

    def cancel(self, name: str) -> None:
        """Note that another request has replaced a reload which is under way."""
        if self.is_pending(name):
            self._loading[name].is_cancelled = True
            self._refuse(name, "another request came before its bundle was loaded")

    def is_pending(self, name: str) -> bool:
        """Return True if a machine is to be reloaded, and is not yet."""
        loading = self._loading.get(name)
        return loading is not None and not loading.is_cancelled

    def refusal(self, name: str) -> str:
        """Return the reason why the latest reload of a machine was refused; "" if it was not."""
        return self._refusals.get(name, "")

    @property
    def is_ready(self) -> bool:
        """True if a bundle is loaded."""
        return bool(self._loading) and any(each.is_done for each in self._loading.values())

    def finish(self) -> list[str]:
        """Reload the machines whose bundles are loaded; between two turns. Return their names."""
        ready = [name for name, each in self._loading.items() if each.is_done]
        loaded = {name: self._loading.pop(name) for name in ready}
        there = {machine.name for machine in self._arrangement.machines}
        asked = [name for name in ready if name in there and not loaded[name].is_cancelled]
        for name in asked:
            self._finish(name, loaded[name])
        return asked

    def _finish(self, name: str, loading: _Loading) -> None:
        arrangement = self._arrangement
        seat = arrangement.roster.find(name)
        is_held = seat.suspended and not loading.suspended and not seat.failure
        try:
            if isinstance(loading.found, str):
                raise LoadError(loading.found)
            if is_held or seat.request == "suspend" or seat.machine.stopping:
                raise LoadError("it was suspended or asked to stop while its bundle was loaded")
            arrangement.reload(name, loading.found)
        except LlfsmError as error:
            self._refuse(name, one_line(error))
        else:
            logger().info("%s is reloaded", name)

    def _refuse(self, name: str, why: str) -> None:
        self._refusals[name] = why
        logger().warning("%s is not reloaded: %s", name, why)


class _Loading:
    """A bundle that is being loaded; `found` is its machine, or what is wrong with it."""

    def __init__(self, path: str, suspended: bool, wake: Callable[[], None]):
        self.suspended = suspended
        self.is_cancelled = self.is_done = False
        self.found: type[Machine] | str = ""
        self._path = path
        self._wake = wake
        threading.Thread(target=self._load, daemon=True).start()

    def _load(self) -> None:
        before = sys.modules.get(self._path)
        try:
            self.found = load_checked(Path(self._path))
        except (Exception, SystemExit) as error:  # of what the bundle includes, whatever it is
            what = "" if isinstance(error, LlfsmError) else f"{type(error).__name__}: "
            self.found = f"{what}{one_line(error)}"
            if before is not None:  # the machine that runs is still of that module
                sys.modules[self._path] = before
        self.is_done = True
        self._wake()
