"""The rover reaches its beacon and touches no wall; what it does when something goes wrong."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from definition import BUILT
from forked import Forked
from llfsm.runtime import Arrangement, ManualClock
from llfsm.whiteboard import Whiteboard
from waiting import PATIENCE_S, wait_for

FOLDER = Path(__file__).parents[2] / "examples" / "rover"
NEEDS_PYMUNK = pytest.mark.skipif(
    find_spec("pymunk") is None, reason="needs pymunk: pip install 'llfsm[examples]'"
)


@NEEDS_PYMUNK
def test_it_reaches_the_beacon_and_touches_no_wall(tmp_path: Path) -> None:
    way = tmp_path / "way.svg"
    done = Forked(
        [sys.executable, str(FOLDER / "drive.py"), str(way)],
        stdout=subprocess.PIPE, text=True, cwd=tmp_path,
    )  # fmt: skip
    output, _ = done.communicate(timeout=100)
    assert output.startswith("the rover: arrived after ")
    assert ", 0 touches of a wall\n" in output
    assert done.returncode == 0
    ET.parse(way)


@NEEDS_PYMUNK
@pytest.mark.skipif(not BUILT, reason="needs shared memory")
def test_in_two_processes_it_begins_to_follow_the_wall(tmp_path: Path) -> None:
    """As on its page. That it arrives is of simulated time, which does not depend on the load."""
    llfsm = [sys.executable, "-m", "llfsm.cli"]
    started = [
        Forked([*llfsm, "run", *words, "--board", "rover", "--directory", str(tmp_path), "-q"],
               cwd=FOLDER, env=dict(os.environ))
        for words in (["world:World", "--period", "10000"], ["rover.toml"])
    ]  # fmt: skip
    try:
        with Whiteboard("rover", directory=tmp_path) as board:

            def has_begun() -> bool:
                slots = {slot.name for slot in board.slots()}
                names = ("rover/picture", "rover/beacon", "rover/wheels")
                if not slots.issuperset(names):
                    return False
                picture, beacon, wheels = (board[board.find(name)] for name in names)
                driven = wheels.get()
                return picture.count > 2 and beacon.count > 2 and getattr(driven, "left", 0.0) > 0

            wait_for(has_begun, "pictures that were looked at, and wheels that turn")
    finally:
        for process in started:
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) in (0, -signal.SIGTERM)


@pytest.fixture
def rover(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Put the rover's machines on a board of this test's; `post` a message and let 10 ms pass."""
    monkeypatch.syspath_prepend(FOLDER)
    slots, machines = import_module("slots"), import_module("rover")
    board, clock = Whiteboard.local(), ManualClock()
    arrangement = Arrangement([machines.Rover, machines.Spotter], whiteboard=board, clock=clock)

    def post(*messages: tuple[Any, Any]) -> tuple[str, Any]:
        for slot, message in messages:
            board.add_message(slot, message)
        for _ in range(2):  # a state's code runs in the turn after the transition
            arrangement.round()
            clock.advance(ms=10)
        return arrangement.state_name_of("Rover"), board.get_message(slots.WHEELS)

    yield SimpleNamespace(post=post, slots=slots, board=board, clock=clock)
    for name in ("slots", "rover"):
        del sys.modules[name]


def test_it_backs_off_what_touches_it(rover: Any) -> None:
    slots = rover.slots
    state, wheels = rover.post((slots.RANGES, slots.Ranges()))
    assert (state, wheels.left > 0, wheels.right > 0) == ("follow", True, True)
    state, wheels = rover.post((slots.BUMPER, slots.Bumper(pressed=True)))
    assert (state, wheels.left < 0, wheels.right < 0) == ("back_off", True, True)


def test_without_ranges_it_stands_still(rover: Any) -> None:
    slots = rover.slots
    assert rover.post((slots.RANGES, slots.Ranges()))[0] == "follow"
    rover.clock.advance(ms=200)
    assert rover.post() == ("blind", slots.Wheels())


@pytest.mark.parametrize(("white", "middle"), [((320, 330), 0.0), ((600, 640), 0.9), ((), None)])
def test_the_beacon_is_found_where_it_is(
    rover: Any, white: tuple[int, ...], middle: float | None
) -> None:
    slots = rover.slots
    columns = [b"\x60" * slots.ROWS] * slots.COLUMNS
    for column in range(*white) if white else ():
        columns[column] = b"\xff" * slots.ROWS
    rover.post((slots.PICTURE, slots.Picture(0, b"".join(columns))))
    found = rover.board.get_message(slots.BEACON)
    assert found.columns == (white[1] - white[0] if white else 0)
    assert found.middle == pytest.approx(middle or 0.0, abs=0.05)
