"""A simulated machine takes the steps of a real one; what was done becomes a test that holds."""

from __future__ import annotations

import asyncio
import re
import runpy
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock

import pytest

from llfsm.bridges.edit.simulation import SimulatedMachine, SimulationProcess
from llfsm.bridges.view.errors import RequestError
from llfsm.errors import LlfsmError

from .conftest import LAMP, FakeWindow

Open = Callable[[], FakeWindow]


@pytest.fixture
def bundle(lamp: Path) -> Path:
    """Let `windows` show the lamp."""
    return lamp


def test_a_machine_is_stepped_fed_and_saved_as_a_test(lamp: Path, tmp_path: Path) -> None:
    simulated = SimulatedMachine([str(lamp)])
    [sensor] = simulated.sensors()
    assert (sensor["name"], sensor["slot"], sensor["value"]) == ("level", "level", [0.0, False])
    assert sensor["schema"]["properties"].keys() == {"value", "on"}
    with pytest.raises(LlfsmError, match="nothing has been simulated yet"):
        simulated.test_text()
    simulated.round()
    assert simulated.describe() == {
        "time_ms": 10.0,
        "rounds": 1,
        "state": "Off",
        "fired": None,
        "over": False,
        "error": "",
        "variables": [("count", "1")],
        "posted": {"lamp": '{"value": 0.0, "on": false}'},
        "read": {},
    }
    simulated.post("level", '{"value": 3, "on": true}')
    simulated.until_state()
    now = simulated.describe()
    assert (now["time_ms"], now["state"], now["fired"]) == (10.01, "On", ("Off", 0))
    simulated.until_state()  # the message is too old after a second
    assert simulated.describe()["state"] == "Off"
    assert simulated.describe()["time_ms"] == pytest.approx(1010, abs=20)
    simulated.advance(500)
    simulated.post("level", '{"value": 2.5, "on": true}')
    simulated.advance(500)
    now = simulated.describe()
    assert (now["state"], now["over"]) == ("End", True)
    rounds = now["rounds"]
    simulated.round()
    assert simulated.describe()["rounds"] == rounds

    saved = tmp_path / "test_lamp.py"
    saved.write_text(simulated.test_text())
    [test] = [f for name, f in runpy.run_path(str(saved)).items() if name.startswith("test_")]
    test()
    (lamp / "State_Off_Transition_0.expr").write_text("level.on and level.value > 2.7\n")
    with pytest.raises(AssertionError):
        test()


@pytest.mark.parametrize(
    ("slot", "text"), [("nothing", "{}"), ("level", "{"), ("level", '{"x": 1}')]
)
def test_what_cannot_be_posted_is_refused(lamp: Path, slot: str, text: str) -> None:
    simulated = SimulatedMachine([str(lamp)])
    with pytest.raises(LlfsmError):
        simulated.post(slot, text)
    simulated.round()
    assert "posted = [\n    ]\n" in simulated.test_text()


def test_code_that_fails_is_shown_where_it_failed(lamp: Path) -> None:
    (lamp / "State_Off_OnEntry.py").write_text("count += 1 / 0\n")
    simulated = SimulatedMachine([str(lamp)])
    simulated.round()
    now = simulated.describe()
    assert (now["over"], "State_Off_OnEntry.py" in now["error"]) == (True, True)
    with pytest.raises(LlfsmError, match="failed"):
        simulated.test_text()


def test_code_that_does_not_return_ends_the_simulation(lamp: Path) -> None:
    (lamp / "State_Off_OnEntry.py").write_text("while True:\n    pass\n")

    async def simulate() -> bool:
        process = await SimulationProcess.start([str(lamp)], patience_s=0.2)
        with pytest.raises(RequestError, match=r"does not return for 0\.2 s"):
            await process.ask("round")
        await process.end()
        return process.has_ended

    assert asyncio.run(simulate())


@pytest.mark.parametrize("steps", range(5))
def test_who_is_cancelled_as_an_answer_comes_takes_none(steps: int) -> None:
    """Else a server that ends would wait for a simulation that goes on."""

    async def cancel() -> None:
        answered = threading.Event()
        worker = Mock(has_ended=False)
        worker.call = lambda *_, **__: answered.wait(60)
        worker.kill = answered.set
        asking = asyncio.create_task(SimulationProcess(worker).ask("round"))
        for _ in range(3):
            await asyncio.sleep(0)
        if steps:
            answered.set()
        for _ in range(steps):
            await asyncio.sleep(0.001)
        if asking.cancel():  # else it has ended already
            with pytest.raises(asyncio.CancelledError):
                await asking
            assert answered.is_set()

    asyncio.run(cancel())


def test_windows_share_a_simulation_whose_code_cannot_harm_them(windows: Open, lamp: Path) -> None:
    window = windows()
    assert window.shown["simulation"] is None
    assert window.ask("step", until="round")["problem"] == "no simulation: press Simulate first"
    window.ask("simulate")
    window.wait(lambda shown: shown["simulation"] and shown["sensors"])
    window.ask("post", slot="level", message={"value": 3, "on": True})
    window.ask("step", until="state")
    window.wait(lambda shown: shown["simulation"]["state"] == "On")  # and what it prints is lost
    assert "is not in 0 to 100" in window.ask("run", speed=1e9)["problem"]
    window.ask("run", speed=100)
    window.wait(lambda shown: shown["simulation"]["state"] == "Off")
    window.ask("run", speed=0)
    window.wait(lambda shown: shown["simulation"]["speed"] == 0)
    assert "def test_Lamp()" in window.ask("save")["done"]

    # What is edited is run after a reset; it may end its process, and be reset again.
    text = {"edit": "set text", "place": {"part": "OnEntry", "state": "Off"}}
    was = LAMP["State_Off_OnEntry.py"]
    deadly = "import os\nos._exit(1)\n"
    assert "done" in window.apply({**text, "text": deadly, "was": was})
    window.ask("simulate")
    assert "has ended its process" in window.ask("step", until="round")["problem"]
    window.wait(lambda shown: "has ended its process" in shown["simulation"]["error"])
    assert "done" in window.apply({**text, "text": "oops(\n", "was": deadly})
    assert "State_Off_OnEntry.py" in window.ask("simulate")["problem"]
    assert "done" in window.ask("end")
    window.wait(lambda shown: shown["simulation"] is None)


def test_a_saved_test_posts_what_was_read(lamp: Path, tmp_path: Path) -> None:
    simulated = SimulatedMachine([str(lamp)])
    for value in (1, 2):
        simulated.post("level", f'{{"value": {value}}}')
    assert simulated.describe()["read"] == {"level": [2.0, False]}
    simulated.round()
    simulated.post("level", '{"value": 3, "on": true}')
    simulated.round()
    saved = tmp_path / "test_lamp.py"
    saved.write_text(simulated.test_text())
    assert re.findall(r"\((.*), 'level', '(.*)'\)", saved.read_text()) == [
        ("0", '{"value": 2}'),
        ("10", '{"value": 3, "on": true}'),
    ]
    command = [sys.executable, "-m", "ruff", "check", "--isolated", "--select", "I,F", str(saved)]
    assert subprocess.run(command, check=False).returncode == 0
