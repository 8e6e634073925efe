"""Ownership of slots: claims on the board, so that no two processes command one unnoticed.

Machines claim the slots to which they post: all claims to a slot are one message, which is replaced
by compare-and-swap, so that of two processes that claim a slot exclusively at the same moment one
fails. Claims of dead processes do not count, and are dropped by whoever writes next.

A process that posts to such a slot without a machine is listed by the machine's process, which
looks whose messages the slot's buffers hold: it need not cooperate.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import count
from typing import TYPE_CHECKING, Any

import msgspec

from llfsm.runtime.engine.errors import ActuatorTakenError, LoadError
from llfsm.runtime.log import logger
from llfsm.runtime.presence.remote import SILENT_S, Directory
from llfsm.whiteboard.errors import (
    BoardClosedError,
    MessageError,
    MessageTooLargeError,
    MessageUnreadableError,
    SlotError,
    WhiteboardError,
)
from llfsm.whiteboard.liveness import (
    born,
    host_name,
    identity,
    is_local,
    lives,
    pid_namespace,
    process_text,
    this_process,
)
from llfsm.whiteboard.messages.llfsm import (
    COMMANDERS,
    MIRROR,
    Commander,
    Commanders,
    commanders_slot,
)
from llfsm.whiteboard.slots import Sample, Slot

if TYPE_CHECKING:
    from llfsm.whiteboard import Board


_WRITERS_NS = 1_000_000_000  # between two looks for processes that post without a machine
_WRITING, _WRITING_NS = 3, 3_000_000_000  # one has posted so many messages in so short a time
_numbers = count()  # they distinguish the claims of this process


class Claims:
    """The claims of an arrangement's machines to the slots that they post to.

    They are written when a machine is loaded and removed when it ends.
    """

    def __init__(self, board: Board):
        self._board = board
        self._slots: dict[Slot[Any], _SlotClaims] = {}
        self._due_ns = 0  # when to look for other writers

    def take(self, machine: str, slots: Mapping[Slot[Any], bool]) -> Callable[[], None]:
        """Claim each of `slots`, exclusively or not; return the function that gives them back.

        Raise `ActuatorTakenError` if another live machine has one of them exclusively, too, and
        `LoadError` if an exclusive claim cannot be written. Any other that cannot be is logged.
        """
        number = next(_numbers)

        def release() -> None:
            for claims in self._slots.values():
                if number in claims.mine:
                    claims.remove(number)

        for slot, exclusive in slots.items():
            mine = Commander(machine, *this_process(), number, exclusive)
            try:
                if slot not in self._slots:
                    self._slots[slot] = _SlotClaims(self._board, slot)
                self._slots[slot].add(mine)
            except LoadError:
                release()
                raise
            except WhiteboardError as error:
                if exclusive:
                    release()
                    what = f"{machine} cannot claim {slot.name!r} exclusively: {error}"
                    raise LoadError(what) from error
                logger().warning("other processes cannot see who posts to %r: %s", slot.name, error)
        return release

    def rename(self, machine: str, published: str) -> None:
        """Change the name of a machine to the one by which other processes see it."""
        for claims in self._slots.values():
            claims.rename(machine, published)

    def look(self) -> None:
        """Log others that command the same slots, once each."""
        now_ns = time.monotonic_ns()
        is_due = now_ns >= self._due_ns
        if is_due:
            self._due_ns = now_ns + _WRITERS_NS
        for claims in self._slots.values():
            try:
                if is_due and claims.mine:
                    claims.list_writers(now_ns)
                claims.look()
            except MessageError:  # another process may write anything
                pass


class _SlotClaims:
    """The claims to one slot; `mine` are those of one arrangement, by number."""

    def __init__(self, board: Board, slot: Slot[Any]):
        self.mine: dict[int, Commander] = {}
        self._board = board
        self._slot = slot.name
        self._commanded = board[slot]
        self._bound = board[commanders_slot(slot.name)]
        self._seen = 0  # the count of the claims when last looked at
        self._reported: set[tuple[object, int]] = set()

    def add(self, mine: Commander) -> None:
        """Claim the slot; raise `ActuatorTakenError` if two claims would be exclusive.

        Where so many are listed already that there is no room for one more, it is left out.
        """
        try:
            self._replace(None, mine, refuse=mine.exclusive)
        except MessageTooLargeError:
            if mine.exclusive:
                raise
            return
        self.mine[mine.number] = mine
        self._report()

    def remove(self, number: int) -> None:
        """Give the slot back; log if that is not possible."""
        mine = self.mine.pop(number)
        try:
            self._replace(mine, None)
        except BoardClosedError:  # nothing is claimed there any more
            pass
        except WhiteboardError as error:
            logger().warning("the claim to %r was not removed: %s", self._slot, error)

    def rename(self, machine: str, published: str) -> None:
        """Change the name of a machine."""
        for number, mine in self.mine.items():
            if mine.machine == machine:
                renamed = msgspec.structs.replace(mine, machine=published)
                with suppress(MessageTooLargeError):
                    self._replace(mine, renamed)
                    self.mine[number] = renamed

    def look(self) -> None:
        """Report new commanders, and write claims again that were overwritten by a mirror's."""
        if self._bound.count != self._seen:
            latest = self._bound.get()
            for mine in self.mine.values():
                if latest is not None and mine not in latest.commanders:
                    with suppress(MessageTooLargeError):
                        self._replace(None, mine)
            self._report()

    def list_writers(self, now_ns: int) -> None:
        """List the processes of this host that post to the slot, but run no machine that does."""
        claims = self._bound.sample()
        commanders = () if claims is None else claims.message.commanders
        posted: dict[int, list[int]] = {}
        for _, stamp_ns, pid in self._commanded.recent():
            if now_ns - stamp_ns < _WRITING_NS:
                posted.setdefault(pid, []).append(stamp_ns)
        writers = {pid for pid, stamps in posted.items() if len(stamps) >= _WRITING}
        if any(not is_local(each) for each in commanders):
            status = self._board[MIRROR].get()  # its daemon adds the messages of other hosts
            writers -= {0 if status is None else status.pid}
        for each in commanders:
            if each.machine:
                writers.discard(each.pid)
            elif is_local(each) and each.pid not in writers:
                self._replace(each, None)
        listed = {each.pid for each in commanders if not each.machine}
        for pid in writers - listed - {os.getpid()}:
            if started := born(pid):
                writer = Commander("", pid, started, host_name(), pid_namespace(), 0)
                with suppress(MessageTooLargeError):
                    self._replace(None, writer)

    def _replace(self, old: Commander | None, new: Commander | None, refuse: bool = False) -> None:
        """Replace a claim by another one, and drop those of machines that are gone."""
        while True:
            sample = self._bound.sample()
            alive = [] if sample is None else _alive(self._board, sample)
            rest = [each for each in alive if each not in (old, new)]
            other = next((each for each in rest if each.exclusive), None)
            if refuse and new is not None and other is not None:
                raise ActuatorTakenError(
                    f"{new.machine} posts to {self._slot!r} exclusively, but {_named(other)} "
                    f"does, too; end that machine first"
                )
            rest += [] if new is None else [new]
            if not any(each.machine for each in rest):  # nobody looks whether they still write
                rest = []
            claims = Commanders(self._slot, tuple(rest))
            if self._bound.add_after(claims, 0 if sample is None else sample.count):
                return

    def _report(self) -> None:
        self._seen = self._bound.count
        claims = self._bound.sample()
        if claims is not None and is_contested(claims.message.commanders):
            commanders = _alive(self._board, claims)  # some may have died
            known = {(identity(each), each.number) for each in commanders}
            if is_contested(commanders) and known - self._reported:
                self._reported |= known
                logger().warning("%s", described(self._slot, commanders))


class OwnReport:
    """Report, once a slot, that this process posts to one which machines of other ones command."""

    def __init__(self, board: Board):
        self._board = board
        self._reported: set[str] = set()

    def look(self) -> None:
        """Log the slots for which this process is listed by now."""
        for slot, commanders in contested_slots(self._board).items():
            ours = any(not each.machine and _is_own(each) for each in commanders)
            if ours and slot not in self._reported:
                self._reported.add(slot)
                logger().warning("%s", described(slot, commanders))


def is_contested(commanders: Sequence[Commander]) -> bool:
    """Check that several processes command a slot, or one exclusively that is not alone."""
    processes = {identity(each) for each in commanders}
    exclusive = any(each.exclusive for each in commanders)
    machines = any(each.machine for each in commanders)
    return machines and (len(processes) > 1 or (exclusive and len(commanders) > 1))


def contested_slots(board: Board) -> dict[str, list[Commander]]:
    """Return the live machines that command a slot, by slot, where it is contested."""
    found = {}
    for info in board.slots():
        if info.name.startswith(COMMANDERS):
            with suppress(SlotError, MessageUnreadableError):  # not claims, whatever its name
                slot = Slot(info.name, Commanders, info.capacity)
                claims = board.present(slot).sample()
                if claims is not None and is_contested(claims.message.commanders):
                    commanders = _alive(board, claims)
                    if is_contested(commanders):
                        found[info.name.removeprefix(COMMANDERS)] = commanders
    return found


def described(slot: str, commanders: Sequence[Commander]) -> str:
    """Return in a sentence which machines command a slot."""
    words = dict(enumerate(("two", "three", "four", "five", "six", "seven", "eight"), start=2))
    number = words.get(len(commanders), len(commanders))
    return f"{slot} has {number} commanders: {', '.join(map(_named, commanders))}"


def _is_own(commander: Commander) -> bool:
    return commander.pid == os.getpid() and is_local(commander)


def _named(commander: Commander) -> str:
    if not commander.machine:
        return process_text(commander, "process")
    alone = ", exclusive" if commander.exclusive else ""
    return f"{commander.machine} ({process_text(commander)}{alone})"


def _alive(board: Board, claims: Sample[Commanders]) -> list[Commander]:
    """Keep those whose process lives; one that cannot be looked up must publish machines here.

    In another PID namespace it may have claimed a moment ago, and not have published any yet.
    """
    elsewhere = None
    is_recent = time.monotonic_ns() - claims.stamp_ns < SILENT_S * 1e9
    found: dict[tuple[int, int], bool] = {}  # one process often runs many machines
    alive = []
    for each in claims.message.commanders:
        if is_local(each):
            process = each.pid, each.born
            if process not in found:
                found[process] = lives(*process)
            if found[process]:
                alive.append(each)
            continue
        if elsewhere is None:
            elsewhere = {identity(machine.status) for machine in Directory(board).machines()}
        if identity(each) in elsewhere or (is_recent and each.host == host_name()):
            alive.append(each)
    return alive
