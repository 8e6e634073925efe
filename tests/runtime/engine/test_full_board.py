"""A machine that was loaded can post, also when the whiteboard's file system is full by then."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from small_disks import small_disk

SCRIPT = """
import os, sys
from llfsm.runtime import Actuator, Arrangement, Machine, State
from llfsm.runtime.engine.environment import BoardEnvironment
from llfsm.whiteboard import BoardFullError, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Bool, String

STOP = Slot("stop", Bool)

class Stops(Machine):
    stop = Actuator(STOP, at_end=Bool(True))
    say = Actuator(Slot("say", String, 2000))
    a, b = State(), State()

    @b.on_entry
    def _(self):
        self.say(String("x" * 1900))

    a.to(b, when=lambda m: True)

def fill(folder):
    with open(os.path.join(folder, "filler"), "ab", buffering=0) as file:
        try:
            while True:
                os.write(file.fileno(), bytes(4096))
        except OSError:
            pass

folder = sys.argv[1]
board = Whiteboard("board", directory=folder)
with Arrangement([Stops], environment=BoardEnvironment(board)) as arrangement:
    fill(folder)
    for _ in range(3):
        arrangement.round()
assert board.get_message(Slot("say", String, 2000)) == String("x" * 1900)
assert board.get_message(STOP) == Bool(True)

# and one that could not is not loaded
class Other(Stops):
    more = Actuator(Slot("more", String, 60000))

arrangement = Arrangement(environment=BoardEnvironment(board))
try:
    arrangement.load(Other)
except BoardFullError as error:
    print(error)
assert not arrangement.machines
"""


@pytest.fixture(name="small_disk")
def _small_disk(tmp_path: Path) -> Iterator[Path]:
    with small_disk(tmp_path, "256k"):
        yield tmp_path


def test_a_machine_that_was_loaded_can_stop_the_robot(small_disk: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(small_disk)],
        text=True,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "no space left in the file system of the board" in done.stdout
