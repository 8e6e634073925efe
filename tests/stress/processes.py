"""Hammer one slot from eight processes.

test_stress.py runs this program; by hand::

    python tests/stress/processes.py reads BOARD SEED 100000000
    python tests/stress/processes.py faults BOARD SEED 1000

What must hold, for four writers and four readers:

1. A message is whole: its bytes follow from its writer and sequence, and its process is the one
   that the slot names.
2. Counts never decrease, nor do the sequences of one writer.
3. One count stands for one message, in every process.
4. In the end the count is the number of adds done; an add whose process was killed before it
   could note it may be there too.
5. While one writer is stopped or dead, wherever it was, everybody else gets on.
6. Nothing is left behind: a killed writer's place and buffers are the next one's.
"""

from __future__ import annotations

import mmap
import os
import random
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from llfsm.whiteboard import Message, Slot, Whiteboard

WRITERS = READERS = 4
RING = 1 << 16
PATIENCE = 60  # seconds in which something must have moved, however busy the machine

_BYTES = random.Random(0).randbytes(1 << 18)


class Load(Message):
    process: int
    writer: int
    sequence: int
    payload: bytes


def payload(writer: int, sequence: int, longest: int) -> bytes:
    """Different at every place from those before and after it, and of all lengths."""
    length = sequence * 7919 % (longest + 1)
    start = (writer * 65537 + sequence * 104729) % (len(_BYTES) - longest)
    return _BYTES[start : start + length]


class Notes:
    """Numbers in memory that the processes share and that survive whoever wrote them."""

    def __init__(self) -> None:
        words = memoryview(mmap.mmap(-1, 8 * (64 + RING))).cast("Q")
        self.stop = words[0:1]
        self.added = words[8 : 8 + WRITERS + 1]  # one for those who come by
        self.reads = words[16 : 16 + READERS]
        self.changes = words[24 : 24 + READERS]
        self.known = words[64:]

    def note(self, count: int, message: Load) -> None:
        """Remember what a count stands for, or check that it is what others found."""
        ours = count << 32 | (message.sequence << 3 | message.writer) & 0xFFFFFFFF
        theirs = self.known[count % RING]
        assert theirs >> 32 != count or theirs == ours, f"two messages of count {count}"
        if theirs >> 32 < count:
            self.known[count % RING] = ours


class Crew:
    """The processes, and what they work on."""

    def __init__(self, wb: Whiteboard, seed: int, longest: int) -> None:
        self.wb = wb
        self.chance = random.Random(seed)
        self.longest = longest
        self.slot = Slot("slot", Load, longest + 64)
        self.notes = Notes()
        self.lives = 0
        self.writers: dict[int, int] = {}  # number -> process
        self.readers: dict[int, int] = {}

    # ---- What the processes do

    def write(self, writer: int, life: int, adds: int = -1) -> None:
        notes, process = self.notes, os.getpid()
        port = Whiteboard(self.wb.name)[self.slot]
        sequence = life << 24  # above all of the lives before
        while not notes.stop[0] and adds:
            sequence += 1
            message = Load(process, writer, sequence, payload(writer, sequence, self.longest))
            count = port.add(message)
            notes.added[writer] += 1
            notes.note(count, message)
            adds -= 1

    def read(self, reader: int) -> None:
        notes = self.notes
        port = Whiteboard(self.wb.name)[self.slot]
        get = port.get
        last: Load | None = None
        last_count, sequences = 0, [0] * (WRITERS + 1)
        while not notes.stop[0]:
            changes = 0
            for _ in range(100):
                message = get()
                if message is not last:
                    assert message is not None
                    self.check(message)
                    assert message.sequence >= sequences[message.writer], "sequences decrease"
                    sequences[message.writer] = message.sequence
                    last = message
                    changes += 1
            if sample := port.sample():
                message, count, _, process = sample
                assert count >= last_count, f"count {count} after {last_count}"
                assert process == message.process, f"{process}'s, and {message.process}'s"
                notes.note(count, message)
                last_count = count
            notes.reads[reader] += 101
            notes.changes[reader] += changes

    def check(self, message: Load) -> None:
        expected = payload(message.writer, message.sequence, self.longest)
        assert message.payload == expected, f"torn: {message.writer}, {message.sequence}"

    # ---- Starting, watching and ending them

    def fork(self, work: Callable[..., None], *arguments: int) -> int:
        process = os.fork()
        if process:
            return process
        try:
            work(*arguments)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)

    def start(self) -> None:
        for reader in range(READERS):
            self.readers[reader] = self.fork(self.read, reader)
        for writer in range(WRITERS):
            self.start_writer(writer)

    def start_writer(self, writer: int) -> None:
        """Start a writer and wait until it has used each of its buffers.

        One at a time: so each gets the place with its own number, and gets it again.
        """
        self.lives += 1
        self.writers[writer] = self.fork(self.write, writer, self.lives)
        progress_of(self.notes.added[writer : writer + 1], 5)

    def add_one(self) -> None:
        """Let a fresh process add a message."""
        self.lives += 1
        process = self.fork(self.write, WRITERS, self.lives, 1)
        assert os.waitpid(process, 0)[1] == 0, "a process failed"

    def progress_but_of(self, writer: int) -> None:
        """Wait until every process has got on, but this writer's."""
        progress_of(self.notes.reads)
        progress_of(self.notes.added[:writer])
        progress_of(self.notes.added[writer + 1 : WRITERS])

    def send(self, writer: int, number: signal.Signals) -> bool:
        """Stop or kill a writer; tell if it was in the middle of writing a message."""
        os.kill(self.writers[writer], number)
        os.waitpid(self.writers[writer], os.WUNTRACED)
        if number == signal.SIGKILL:
            del self.writers[writer]
        return is_half_written(self.wb.path, writer)

    def end(self) -> str:
        """Let all end well; tell what they did."""
        self.notes.stop[0] = 1
        for processes in (self.writers, self.readers):
            while processes:
                _, process = processes.popitem()
                assert os.waitpid(process, 0)[1] == 0, "a process failed"
        reads, changes = sum(self.notes.reads), sum(self.notes.changes)
        return f"{sum(self.notes.added)} adds, {reads} reads, {changes} of something new"

    def kill(self) -> None:
        """End what is left of a run that went wrong."""
        for process in (*self.writers.values(), *self.readers.values()):
            os.kill(process, signal.SIGKILL)


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        ended = os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        assert ended is None, f"process {ended.si_pid} ended with {ended.si_status}"
        assert time.monotonic() < deadline, "nothing moves"
        time.sleep(0.0005)


def progress_of(numbers: memoryview, by: int = 1) -> None:
    """Wait until each number has grown."""
    before = list(numbers)
    wait_until(lambda: all(n >= b + by for n, b in zip(numbers, before, strict=True)))


# ---- What the file holds (see llfsm_whiteboard.h)


def peek(board: Path, at: int) -> int:
    with board.open("rb", buffering=0) as file:
        file.seek(at)
        return int.from_bytes(file.read(8), "little")


def published(board: Path) -> int:
    """Return the place, writer and buffer, of the first slot's latest message."""
    return peek(board, peek(board, 448) + 64) & 0xFFFF


def is_half_written(board: Path, writer: int) -> bool:
    """Tell if a count is 0 in the first slot's buffers of the writer with this place."""
    slot = peek(board, 448)
    stride = (32 + peek(board, slot + 16) + 63) // 64 * 64
    block = peek(board, slot + 128 + 8 * writer)
    return any(peek(board, block + 64 + i * stride) == 0 for i in range(4))


# ---- Scenarios


def read_much(crew: Crew, reads: int) -> str:
    """Read so often altogether, and a thirtieth of it messages new to their reader."""
    notes = crew.notes
    crew.start()
    while sum(notes.reads) < reads or sum(notes.changes) < reads // 30:
        progress_of(notes.reads)
    done = crew.end()
    count, added = crew.wb[crew.slot].count, sum(notes.added)
    assert count == added, f"count {count} after {added} adds"
    return done


def stop_and_kill(crew: Crew, faults: int) -> str:
    """Stop and kill writers of messages of up to 64 KiB, which are mostly busy writing.

    Do so often enough that one was hit in the middle of a write, and at least `faults` times.
    """
    notes, chance = crew.notes, crew.chance
    crew.start()
    crew.add_one()
    size = crew.wb.path.stat().st_size
    number = kills = hits = 0
    while number < faults or not hits:
        number += 1
        writer = chance.randrange(WRITERS)
        time.sleep(chance.random() / 500)  # so that it is hit anywhere
        if chance.random() < 0.5:
            kills += 1
            hits += crew.send(writer, signal.SIGKILL)
            crew.progress_but_of(writer)
            crew.start_writer(writer)
        else:
            hits += crew.send(writer, signal.SIGSTOP)
            crew.progress_but_of(writer)
            os.kill(crew.writers[writer], signal.SIGCONT)
            progress_of(notes.added[writer : writer + 1])
    for number in (signal.SIGSTOP, signal.SIGKILL):  # all of them
        for writer in range(WRITERS):
            crew.send(writer, number)
        for _ in range(5):  # after SIGKILL, each has the place of the one before
            before, place = crew.wb[crew.slot].count, published(crew.wb.path)
            crew.add_one()
            assert crew.wb[crew.slot].count == before + 1, "the slot is stuck"
            assert published(crew.wb.path) != place, "an add overwrote the latest message"
        progress_of(notes.reads)
    done = crew.end()
    kills += WRITERS
    count, added = crew.wb[crew.slot].count, sum(notes.added)
    assert added <= count <= added + kills, f"count {count}, {added} adds noted, {kills} kills"
    assert crew.wb.path.stat().st_size == size, "the board has grown"
    return f"{done}, {kills} kills, {hits} of {number} faults in the middle of a write"


def main(scenario: str, board: str, seed: str, amount: str) -> None:
    work, longest = {"reads": (read_much, 900), "faults": (stop_and_kill, 1 << 16)}[scenario]
    with Whiteboard(board) as wb:
        crew = Crew(wb, int(seed), longest)
        try:
            print(work(crew, int(amount)))
        except AssertionError as error:
            sys.exit(f"with seed {seed}: {error}")
        finally:
            crew.kill()
            wb.remove()


if __name__ == "__main__":
    main(*sys.argv[1:])
