"""Use a board with 100 slots of 1 KiB, run 4 machines on it; print the resident bytes."""

import re
import sys
from pathlib import Path

from llfsm.runtime import Actuator, Arrangement, Machine, Sensor, State
from llfsm.whiteboard import Message, Slot, Whiteboard


class Note(Message):
    """Fill a slot."""

    text: str = ""


SLOTS = [Slot(f"bench/{number}", Note, capacity=1024) for number in range(100)]


class Copier(Machine):
    """Copy one slot to another, as long as it runs."""

    source = Sensor(SLOTS[0])
    copy = Actuator(SLOTS[-1])

    read = State()
    write = State()

    @read.to(write)
    def something_there(self) -> bool:
        return self.source is not None

    @write.on_entry
    def _(self) -> None:
        assert self.source is not None
        self.copy(self.source)

    write.to(read)


with Whiteboard(sys.argv[1]) as board:
    try:
        for slot in SLOTS:
            board.add_message(slot, Note("x" * 1000))
        assert all(board.get_message(slot) for slot in SLOTS)
        Arrangement([Copier() for _ in range(4)], whiteboard=board).run(max_rounds=1000)
        status = Path("/proc/self/status").read_text()
    finally:
        board.remove()
resident = re.search(r"^VmRSS:\s+(\d+) kB$", status, re.MULTILINE)
assert resident
print(int(resident[1]) * 1024)
