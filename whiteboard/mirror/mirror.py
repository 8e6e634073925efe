"""A board, mirrored: the exchange and the network together, in a loop that sleeps on the board."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable

from ..board import Board
from ..messages.llfsm import MirrorStatus
from .exchange import Exchange, Question
from .journal import Journal
from .network import Network
from .settings import Settings
from .store import Store

__all__ = ["Mirror"]

_TICK_S = 0.005  # from one sending to the next: what changes meanwhile travels together
_BEAT_S = 0.25
_MEET_S = 0.02  # from being connected to knowing what the other host listens to


class Mirror:
    """Mirrors one board until it is closed.

    Args:
        board: any kind.
        name: by which the hosts of the board find each other.
        settings: see :class:`.Settings`.
        journal: what is known of the board already.
        host: the id of this host.
        mode: see :class:`.Network`.

    """

    def __init__(
        self,
        board: Board,
        settings: Settings,
        journal: Journal,
        *,
        host: int | None = None,
        mode: str = "peer",
    ) -> None:
        host = secrets.randbits(63) if host is None else host
        self._board = board
        self._watch = board.watcher()
        store = Store(board, host, _wall_ns, journal)
        self._exchange = Exchange(store, settings, time.monotonic_ns, time.time_ns)
        self._stop = threading.Event()
        self._answered = threading.Event()
        self._network = Network(board.name, host, settings, mode)
        self._network.join(self)

    def run(self, look: Callable[[MirrorStatus], None] = lambda _: None) -> None:
        """Mirror until stopped or the board is removed; `look` is told how it is, once a second."""
        beat = told = 0.0
        while not self._stop.is_set() and self._board.alive:
            now = time.monotonic()
            if now >= beat:
                beat = now + _BEAT_S
                self._network.send_beat(self._exchange.beat())
                self._ask()
            if now >= told:
                told = now + 1
                look(self._exchange.status())
            self._exchange.enter_held()
            due_ns = self._exchange.due_ns()
            due = beat if due_ns is None else min(beat, due_ns / 1e9)
            if self._send(self._exchange.collect(self._watch(max(0, due - time.monotonic())))):
                self._stop.wait(_TICK_S)
        self._send(self._exchange.collect(self._watch(0), all_of_it=True))

    @property
    def listens(self) -> tuple[str, ...]:
        """Where other hosts reach this one."""
        return self._network.listens

    def stop(self) -> None:
        """Let :meth:`run` send what is left and return, soon."""
        self._stop.set()

    def close(self) -> None:
        """Leave the network; once :meth:`run` has returned."""
        self._network.close()

    def wait_for_answer(self, seconds: float) -> bool:
        """Wait until another host has told what it has; False if none has in time."""
        return self._answered.wait(seconds)

    def _send(self, batches: list[bytes]) -> bool:
        for data in batches:
            self._network.send(data)
        self._exchange.sent()
        return bool(batches)

    def _ask(self) -> None:
        for question in self._exchange.questions():
            self._network.ask(question)

    def refuse(self, what: str, why: str) -> None:
        """Count what the network has refused, and report it once."""
        self._exchange.refuse(what, why)

    # ---- In threads of the network ----------------------------------------------------------

    def linked(self) -> None:
        """Tell a host that was just connected of this one, for it to ask what it has missed."""
        self._stop.wait(_MEET_S)
        self._network.send_beat(self._exchange.beat())

    def hear(self, data: bytes) -> None:
        """Take a batch."""
        self._exchange.hear(data)
        self._ask()

    def hear_beat(self, data: bytes) -> None:
        """Take a sign of life; answer the first one, so that its sender need not wait for ours."""
        if self._exchange.hear_beat(data):
            self._network.send_beat(self._exchange.beat())
        self._ask()

    def answer(self, data: bytes) -> list[bytes]:
        """Answer a question."""
        return self._exchange.answer(data)

    def hear_answer(self, data: bytes) -> None:
        """Take a part of an answer."""
        self._exchange.hear_answer(data)

    def answered(self, question: Question, *, whole: bool) -> None:
        """Take note that no more comes of an answer."""
        self._exchange.answered(question, whole=whole)
        if whole:
            self._answered.set()


def _wall_ns(stamp_ns: int) -> int:
    """Return the time since 1970 of a stamp of the monotonic clock; never one to come."""
    return time.time_ns() - max(0, time.monotonic_ns() - stamp_ns)
