"""Guards: they execute the last wills of machines whose processes died without shutting down.

The kernel reports the death of a process of this host at once, through a descriptor that the guard
polls together with the others; ids are used again, so the time at which a process began is looked
up, too, and after the descriptor was opened. One that executes another program has died as well,
though its id and its begin stay. A process of another host, or one that may only be
silent for so long, counts as dead when its status is too old. Any number of guards may watch a
board: `execute` lets one of them post each value.

New wills ring a bell; a search of the board once a second finds those of other hosts, which ring
none here.
"""

from __future__ import annotations

import logging
import os
import select
import threading
import time
from contextlib import closing, suppress
from typing import TYPE_CHECKING, NamedTuple, Self

import msgspec

from llfsm.errors import one_line
from llfsm.runtime.presence.slot_ownership import OwnReport
from llfsm.runtime.presence.will import execute, reserve
from llfsm.whiteboard import BoardNotFoundError, MessageError, Whiteboard, WhiteboardError
from llfsm.whiteboard.board_files import DIRECTORY
from llfsm.whiteboard.errors import BoardClosedError, BoardFullError, SlotError
from llfsm.whiteboard.liveness import Program, host_name, identity, is_local, lives
from llfsm.whiteboard.messages.llfsm import (
    MIRROR,
    WILL_BELL,
    WILLS,
    Bell,
    LastWill,
    MirrorStatus,
    WillExecution,
    execution_slot,
    status_slot,
    will_slot,
)
from llfsm.whiteboard.mirror.naming import Naming
from llfsm.whiteboard.mirror.stand_ins import note_stand_in, noted_machines, strike_out
from llfsm.whiteboard.shared import require_shared_memory

if TYPE_CHECKING:
    from llfsm.whiteboard import Board, BoundSlot, Sample


_LOOK_S = 0.05  # between two looks for new wills and silent processes; a death is seen at once
_PROGRAM_S = 0.1  # between two looks whether a process executes another program
_LIST_S = 1.0  # between two searches for wills that have rung no bell here: those of other hosts
_OPEN_S = 0.3  # between two attempts to open a board that is not there

_log = logging.getLogger("llfsm.guard")


class _Death(NamedTuple):
    """The reason for which a process counts as dead."""

    why: str
    silent_ns: int = 0
    """For how long it must have been silent; 0 if it does not exist."""
    here_only: bool = False
    """True if other hosts may still hear it, so that this one acts on its own board alone."""


class _Process:
    """A process that has left wills: many machines cost two descriptors, and one look."""

    def __init__(self, id_: tuple[int, int, int], program: Program):
        self.id = id_
        pid, born, _ = id_
        self._program = program
        self._due_s = 0.0  # when to look next whether it executes another one
        self.wills = 0
        """How many of its wills are watched."""
        self.pidfd: int | None = None
        with suppress(OSError, OverflowError):  # no such process, or too many files
            self.pidfd = os.pidfd_open(pid)
        self.died = not lives(pid, born)  # looked up after that, as ids are used again
        self.replaced = False
        """True if it executes another program now."""

    def look(self, now_s: float) -> None:
        """Look up what no pidfd reports: another program; if there is none, a death, too."""
        pid, born, executes = self.id
        if self.pidfd is None:
            self.died = self.died or not lives(pid, born)
        if executes and not self.died and now_s >= self._due_s:
            self._due_s = now_s + _PROGRAM_S
            if self._program.look() not in (0, executes):
                self.died = self.replaced = lives(pid, born)

    def close(self) -> None:
        """Close its descriptors."""
        self._program.close()
        if self.pidfd is not None:
            os.close(self.pidfd)


class _Watched:
    """A machine's slot for its last will, and the process that has left the latest."""

    def __init__(self, machine: str, slot: BoundSlot[LastWill]):
        self.machine = machine
        self.slot_name = WILLS + machine
        self.slot = slot
        self.sample: Sample[LastWill] | None = None
        self.process: _Process | None = None
        """The one that has left it, if it can be looked up."""
        self.failed: dict[str, str] = {}
        self.retry_s = 0.0
        """When to try again to post what could not be posted."""

    @property
    def will(self) -> LastWill | None:
        """The will, while there is something to execute."""
        return None if self.sample is None else self.sample.message

    @property
    def is_elsewhere(self) -> bool:
        """True if a daemon has added the will: its machine runs on another host's board."""
        return self.sample is not None and self.sample.writer != self.sample.message.pid


class Guard:
    """Watch the last wills on a board, and execute those of processes that have died."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._bell: BoundSlot[Bell] | None = None
        with suppress(BoardFullError):
            self._bell = board[WILL_BELL]
        self._own = OwnReport(board)
        self._rung = -1
        self._list_s = 0.0
        self._poll = select.poll()
        self._watched: dict[str, _Watched] = {}  # by name of the slot
        self._processes: dict[tuple[int, int, int], _Process] = {}
        self._by_pidfd: dict[int, _Process] = {}

    def look(self) -> None:
        """Find new wills, and execute those of dead processes."""
        now_s = time.monotonic()
        rung = 0 if self._bell is None else self._bell.count
        if rung != self._rung or now_s >= self._list_s:
            self._rung, self._list_s = rung, now_s + _LIST_S
            self._list()
            self._own.look()
            self._strike_out()
        for process in self._processes.values():
            process.look(now_s)
        for watched in self._watched.values():
            self._read(watched)
            death = self._death(watched)
            if death is not None and now_s >= watched.retry_s:
                watched.retry_s = now_s + _LIST_S
                self._execute(watched, death)

    def wait(self, timeout_s: float) -> None:
        """Wait until a process that has left a will dies, or the time has passed."""
        for pidfd, _ in self._poll.poll(timeout_s * 1e3):
            self._by_pidfd[pidfd].died = True
            self._poll.unregister(pidfd)

    def close(self) -> None:
        """Release the processes."""
        for watched in self._watched.values():
            self._release(watched)

    def _list(self) -> None:
        listed = [info.name for info in self._board.slots() if info.name.startswith(WILLS)]
        for name in self._watched.keys() - {*listed}:  # it was given up
            watched = self._watched.pop(name)
            self._release(watched)
            self._board.forget(will_slot(watched.machine))
        for name in listed:
            if name not in self._watched:
                machine = name.removeprefix(WILLS)
                with suppress(SlotError):  # not a will, whatever its name, or given up since
                    self._watched[name] = _Watched(machine, self._board.present(will_slot(machine)))

    def _strike_out(self) -> None:
        """Let what stands in for a machine that is heard again give way to its own messages."""
        limit_ns, heard = self._mirror().partition_s * 1e9, set()
        for machine in noted_machines(self._board):
            with suppress(WhiteboardError):
                status = self._board.present(status_slot(machine)).sample()
                if status is not None and time.monotonic_ns() - status.stamp_ns < limit_ns:
                    heard.add(machine)
        if heard:
            strike_out(self._board, heard)

    def _read(self, watched: _Watched) -> None:
        """Read the will, and watch its process if it is a new one."""
        try:
            sample = watched.slot.sample()
        except MessageError:  # another process may write anything
            sample = None
        if sample is not None and sample.message.state != "left":
            sample = None
        before = watched.sample
        if sample is before or (sample and before and sample.count == before.count):
            return
        self._release(watched)
        watched.sample = sample
        if sample is not None:
            if is_local(sample.message):
                watched.process = self._open(sample.message)
            reserve(self._board, self._here(watched, sample.message))
            with suppress(WhiteboardError):  # for the mark that it was executed
                watched.slot.reserve()

    def _open(self, will: LastWill) -> _Process:
        """Watch the will's process."""
        program = Program(will.pid)
        key = will.pid, will.born, program.look()
        process = self._processes.get(key)
        if process is None:
            process = self._processes[key] = _Process(key, program)
            if process.pidfd is not None:
                self._by_pidfd[process.pidfd] = process
                self._poll.register(process.pidfd, select.POLLIN)
        else:
            program.close()
        process.wills += 1
        return process

    def _release(self, watched: _Watched) -> None:
        process, watched.process = watched.process, None
        watched.failed, watched.retry_s = {}, 0.0
        if process is None:
            return
        process.wills -= 1
        if not process.wills:
            del self._processes[process.id]
            if process.pidfd is not None:
                with suppress(KeyError):  # it has died
                    self._poll.unregister(process.pidfd)
                del self._by_pidfd[process.pidfd]
            process.close()

    def _death(self, watched: _Watched) -> _Death | None:
        """Find the reason for which the process counts as dead; None if it does not."""
        will = watched.will
        if will is None:
            return None
        if watched.process is not None and watched.process.died:
            replaced = watched.process.replaced
            return _Death("executes another program" if replaced else "died without shutting down")
        local = watched.process is not None
        limit_s = will.silent_ms / 1e3 if local else self._mirror().partition_s
        silent_s = self._silent_s(watched.machine, will) if limit_s else 0.0
        if watched.sample is not None and watched.is_elsewhere:  # a sign of life, too
            silent_s = min(silent_s, (time.monotonic_ns() - watched.sample.stamp_ns) / 1e9)
        if silent_s <= limit_s or not silent_s:
            return None
        host = "" if local else f"of host {will.host} "
        why = f"{host}was silent for {silent_s:.1f} s"
        return _Death(why, int(limit_s * 1e9), here_only=watched.is_elsewhere)

    def _mirror(self) -> MirrorStatus:
        """Return the status of the daemon, with its configuration; defaults without a daemon."""
        status = None
        with suppress(WhiteboardError):
            status = self._board[MIRROR].get()
        return status or MirrorStatus()

    def _here(self, watched: _Watched, will: LastWill) -> LastWill:
        """Return a will with the names that its slots have on this host's board."""
        mirror = self._mirror()
        return Naming(mirror.name, mirror.fleet).will(watched.slot_name, will)

    def _silent_s(self, machine: str, will: LastWill) -> float:
        """Return the seconds since the process published a status; 0 if it never has."""
        with suppress(WhiteboardError):
            sample = self._board.present(status_slot(machine)).sample()
            if sample is not None and identity(sample.message) == identity(will):
                return (time.monotonic_ns() - sample.stamp_ns) / 1e9
        return 0.0

    def _execute(self, watched: _Watched, death: _Death) -> None:
        sample = watched.sample
        if sample is None or watched.slot.count != sample.count:  # withdrawn before the death
            return
        here = sample._replace(message=self._here(watched, sample.message))
        outcome = execute(
            self._board,
            here,
            silent_ns=death.silent_ns,
            is_commanded=self._is_commanded,
            stands_in_for=watched.machine if death.here_only else "",
        )
        what = f"{watched.machine}: process {sample.message.pid} {death.why}"
        if outcome.posted:
            _log.warning("%s; posted its safe values to %s", what, ", ".join(outcome.posted))
        if outcome.failed and outcome.failed != watched.failed:
            watched.failed = outcome.failed
            _log.error("%s; its safe values cannot be posted: %s", what, outcome.failed)
        if outcome.deferred:
            watched.retry_s = 0.0
        if outcome.failed or outcome.deferred:
            return
        executed = msgspec.structs.replace(sample.message, state="executed", executor=os.getpid())
        with suppress(WhiteboardError):  # it was executed all the same
            if death.here_only:
                mark = sample.count + 1
                note_stand_in(self._board, watched.slot_name, mark, watched.machine)
                self._report(watched.machine, sample.message)
            watched.slot.add_after(executed, sample.count)

    def _report(self, machine: str, will: LastWill) -> None:
        """Report to a machine's process that its last will is executed on this host."""
        machine_process = will.pid, will.born, will.host, will.namespace
        report = WillExecution(*machine_process, os.getpid(), host_name())
        self._board.add_message(execution_slot(machine), report)

    def _is_commanded(self, slot: str) -> bool:
        """Check that a process that lives has a last will for the slot, so may post to it."""
        return any(
            slot in {value.slot for value in self._here(watched, watched.will).values}
            for watched in self._watched.values()
            if watched.will is not None and self._death(watched) is None
        )


class GuardThread:
    """Guard a board of this host in a thread, within a ``with`` block.

    The board may be made later, and removed and made again. It begins after `after_s` seconds: what
    passes the safe values on may not be ready before.
    """

    def __init__(
        self, name: str, directory: str | os.PathLike[str] = DIRECTORY, *, after_s: float = 0.0
    ) -> None:
        require_shared_memory()
        self._name = name
        self._directory = directory
        self._after_s = after_s
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="guard", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        problem = ""
        self._over.wait(self._after_s)
        while not self._over.is_set():
            try:
                with Whiteboard(self._name, directory=self._directory, create=False) as board:
                    self._guard(board)
            except (BoardNotFoundError, BoardClosedError):
                pass  # it is not there yet, or was removed
            except Exception as error:  # a guard that ends guards nothing
                if str(error) != problem:
                    problem = str(error)
                    expected = isinstance(error, WhiteboardError)  # else it is a mistake of ours
                    what = f"the whiteboard {self._name} cannot be guarded: {one_line(error)}"
                    _log.error(what, exc_info=not expected)
            self._over.wait(_OPEN_S)

    def _guard(self, board: Whiteboard) -> None:
        with closing(Guard(board)) as guard:
            _log.debug("guarding the whiteboard %s", self._name)
            while board.alive and not self._over.is_set():
                guard.look()
                guard.wait(_LOOK_S)
