"""Boards, files and `llfsm` processes for recordings."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from calling import call
from forked import Forked
from llfsm.bridges.recording.reader import RecordedMessage, Recording
from llfsm.bridges.recording.writer import ABOUT, RecordingWriter
from llfsm.runtime.journal.entries import Entry
from llfsm.whiteboard import Board, BoundSlot, Message, Sample, Slot, Whiteboard
from llfsm.whiteboard.local import LocalBoard
from own_boards import own_board
from waiting import rest_of


class Reading(Message):
    """One field of each kind that matters."""

    number: int = 0
    real: float = 0.0
    text: str = ""
    data: bytes = b""
    maybe: float | None = None
    each: tuple[float, ...] = ()


READING = Slot("robot/reading", Reading)
OTHER = Slot("robot/other", Reading)


@pytest.fixture
def board() -> Iterator[Whiteboard]:
    with own_board() as name, Whiteboard(name) as board:
        yield board


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[Path]]:
    """Have temporary files in a folder of the test's own; return what lists them."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return lambda: [*folder.iterdir()]


Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def llfsm(tmp_path: Path, board: Whiteboard) -> Iterator[Start]:
    """Start `llfsm` processes in a folder of their own; none outlives the test's board."""
    started: list[subprocess.Popen[str]] = []

    def start(
        *arguments: object, within: Sequence[str] = (), **options: Any
    ) -> subprocess.Popen[str]:
        process = Forked(
            [*within, sys.executable, "-m", "llfsm.cli", *map(str, arguments)],
            cwd=tmp_path,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            **options,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        rest_of(process)


@pytest.fixture
def llfsm_here(tmp_path: Path) -> Callable[..., tuple[int, str]]:
    """Call `llfsm` in that folder and this process; return its exit status and what it prints."""

    def run(*arguments: object) -> tuple[int, str]:
        done = call(*map(str, arguments), cwd=tmp_path)
        return done.returncode, done.stdout + done.stderr

    return run


def end_of(process: subprocess.Popen[str]) -> tuple[int, str]:
    printed = rest_of(process)
    return process.returncode, printed


def write(file: Path, samples: list[tuple[Slot[Any], Sample[Any]]]) -> None:
    """Make a recording of these samples."""
    with RecordingWriter(file, {"board": "test"}) as writer:
        for slot, sample in samples:
            writer.add(slot, sample)


@contextmanager
def foreign_writer(file: Path) -> Iterator[Writer]:
    """Make a recording with the library alone, to put into it what we never write."""
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="llfsm")
        writer.add_metadata(ABOUT, {"offset_ns": "0", "begin_ns": "0"})
        yield writer
        writer.finish()


def keep_journal(
    writer: RecordingWriter, entries: Iterable[Entry], *, process: int = 1, whole: bool = True
) -> None:
    """Write the journal of an arrangement."""
    about = {"session": f"{process}-0", "writer": str(process), "whole": "yes" if whole else "no"}
    journal = writer.add_journal(about)
    for entry in entries:
        writer.add_entry(journal, entry)


def messages_of(recording: Recording, slot: str) -> list[RecordedMessage]:
    return [recorded for _, recorded in recording.messages([slot])]


def entries_in(recording: Recording) -> list[Entry]:
    return [entry for journal in recording.journals for entry in recording.entries(journal)]


def samples_of(board: Board, slot: Slot[Any], messages: list[Any]) -> list[tuple[Slot[Any], Any]]:
    found = []
    for message in messages:
        board.add_message(slot, message)
        found.append((slot, board[slot].sample()))
    return found


class Spy(LocalBoard):
    """A board that remembers every message that was added."""

    def __init__(self, now: Callable[[], int] = time.monotonic_ns) -> None:
        super().__init__()
        self.added: list[tuple[int, str, Message]] = []
        self._now = now

    def publisher(self, slot: Slot[Any]) -> BoundSlot[Any]:
        bound = super().publisher(slot)
        add = bound.add

        def remember(message: Any, /) -> int:
            self.added.append((self._now(), slot.name, message))
            return add(message)

        bound.add = remember  # type: ignore[method-assign]
        return bound
