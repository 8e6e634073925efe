"""Arrangements whose journals are kept, to run again."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from llfsm.bridges.recording.rerun import Rerun
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.runtime import Actuator, Arrangement, Machine, ManualClock, Sensor, State, Trace
from llfsm.runtime.journal.entries import Entry, Journal, entries_of
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Board, Whiteboard

from .conftest import keep_journal
from .machines import COMMAND, SEEN, Number


class JumpingClock(ManualClock):
    """Time passes at each look, so that the order of looks matters."""

    def __init__(self, step_ns: int = 700_001):
        super().__init__()
        self._step_ns = step_ns

    def now_ns(self) -> int:
        self._now_ns += self._step_ns
        return self._now_ns


class Run:
    """An arrangement whose journal is kept."""

    def __init__(
        self,
        machines: Iterable[Any],
        board: Board | None = None,
        *,
        clock: ManualClock | None = None,
        **options: Any,
    ):
        self.board = board or Whiteboard.local()
        self.written: list[bytes] = []
        self.trace = Trace()
        self.clock = clock
        live = LiveEnvironment(self.board, clock)
        environment = JournalledEnvironment(live, Journal(self.written.append))
        self.arrangement = Arrangement(
            machines, environment=environment, observers=[self.trace], **options
        )

    @property
    def entries(self) -> list[Entry]:
        return [entry for data in self.written for entry in entries_of(data)]

    def again(self, machines: Iterable[Any], **options: Any) -> tuple[Any, Trace]:
        """Return the first difference, and all that happens when they run again."""
        trace = Trace()
        run = Rerun(self.entries)
        run.arrange(machines, observers=[trace], **options)
        return run.compare(), trace


def keep(run: Run, file: Path) -> Path:
    with RecordingWriter(file, {"board": "test"}) as writer:
        keep_journal(writer, run.entries)
    return file


class Patrol(Machine):
    command = Sensor(COMMAND, default=Number(0))
    post = Actuator(SEEN, at_end=Number(-1))

    wait = State()
    go = State()

    @go.on_entry
    def _(self) -> None:
        self.post(Number(self.command.value))

    wait.to(go, when=lambda m: m.command.value > 5)
    go.to(wait, after_ms=50)


def patrol() -> Run:
    run = Run([Patrol], clock=JumpingClock())
    for value in (0, 3, 6, 9, 12, 3, 3, 3):
        run.board.add_message(COMMAND, Number(value))
        run.clock.advance(ms=20)
        run.arrangement.round()
    run.arrangement.end()
    return run
