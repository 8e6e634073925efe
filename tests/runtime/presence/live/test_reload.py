"""A bundle is loaded again into a running arrangement: all of it, or nothing."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from llfsm.runtime import Arrangement, ManualClock
from llfsm.runtime.bundles import load_bundle
from llfsm.runtime.debugging.debugger import Debugger
from llfsm.runtime.engine.environment import BoardEnvironment
from llfsm.runtime.engine.errors import LoadError
from llfsm.runtime.journal.entries import Journal
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.runtime.presence.remote import Directory
from llfsm.runtime.presence.status_publisher import Reloads
from llfsm.whiteboard import Board, Slot, Whiteboard
from llfsm.whiteboard.messages.llfsm import (
    MachineStatus,
    commanders_slot,
    definition_slot,
    status_slot,
    will_slot,
)
from llfsm.whiteboard.messages.std_msgs import Bool
from waiting import wait_for

from .machines import Idle

FILES = {
    "Language": "python\n",
    "States": "Off\nOn\n",
    "Lamp_Includes.py": (
        "from llfsm.runtime import Actuator, Sensor\n"
        "from llfsm.whiteboard import Slot\n"
        "from llfsm.whiteboard.messages.std_msgs import Bool, Int32\n"
    ),
    "Lamp_Variables.py": (
        "button = Sensor(Slot('button', Bool), default=Bool())\n"
        "lamp = Actuator(Slot('lamp', Int32), at_end=Int32(0), at_failure=Int32(-1))\n"
        "level: int = 1\n"
    ),
    "State_Off_OnEntry.py": "\n",
    "State_Off_Transition_0.target": "On\n",
    "State_Off_Transition_0.expr": "button.data\n",
    "State_On_OnEntry.py": "lamp(Int32(level))\n",
    "State_On_Transition_0.target": "Off\n",
    "State_On_Transition_0.expr": "not button.data\n",
}
OTHER = {
    "States": "Dark\nBright\n",
    "Lamp_Variables.py": (
        "switch = Sensor(Slot('switch', Bool), default=Bool())\n"
        "lamp = Actuator(Slot('lamp', Int32), at_end=Int32(0), at_failure=Int32(-2))\n"
        "bell = Actuator(Slot('bell', Int32), at_end=Int32(7))\n"
        "level: int = 1\n"
    ),
    "State_Dark_OnEntry.py": "bell(Int32(1))\n",
    "State_Dark_Transition_0.target": "Bright\n",
    "State_Dark_Transition_0.expr": "switch.data\n",
    "State_Bright_OnEntry.py": "lamp(Int32(10 * level))\n",
    "State_Bright_Transition_0.target": "Dark\n",
    "State_Bright_Transition_0.expr": "not switch.data\n",
}


def waiting_for(gate: Path) -> str:
    """Return includes that take until something is written to a pipe."""
    wait = f"import pathlib\n\npathlib.Path({str(gate)!r}).read_text()\n"
    return wait + FILES["Lamp_Includes.py"]


class Running:
    """An arrangement of a bundle and another machine, in a thread."""

    def __init__(self, folder: Path, board: Board, **options: object):
        self.folder, self.board = folder, board
        self.arrangement = Arrangement(whiteboard=board, idle_us=3000, **options)  # type: ignore[arg-type]
        self.arrangement.load(Idle)
        self.arrangement.load(load_bundle(folder), variables={"level": 3})
        self.thread = threading.Thread(target=self.arrangement.run, kwargs={"grace_s": 0.0})
        self.thread.start()
        self.status = board[status_slot("Lamp")]
        wait_for(lambda: self.status.count, "the machine is published")

    def shows(self, holds: Callable[[MachineStatus], object], what: str) -> MachineStatus:
        wait_for(lambda: holds(self.status.get()), what)
        return self.status.get()

    def write(self, files: dict[str, str]) -> None:
        for name, text in files.items():
            (self.folder / name).write_text(text)

    def ask(self, action: str = "reload") -> MachineStatus:
        """Ask for something, and return the status once that is done or refused."""
        before = self.status.get().obeyed
        Directory(self.board).find("Lamp").request(action)  # type: ignore[arg-type]
        return self.shows(lambda s: s.obeyed > before and not s.pending, f"{action} is done")

    def press(self, button: str) -> None:
        self.board[Slot(button, Bool)].add(Bool(True))

    def value(self, slot: str) -> int | None:
        message = self.board[self.board.find(slot)].get()
        return None if message is None else message.data


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "Lamp.machine"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def shared(tmp_path: Path) -> Iterator[Whiteboard]:
    with Whiteboard("board", directory=tmp_path) as board:
        yield board


@pytest.fixture
def run(folder: Path, shared: Whiteboard) -> Iterator[Callable[..., Running]]:
    started: list[Running] = []

    def run(**options: object) -> Running:
        started.append(Running(folder, shared, **options))
        return started[-1]

    yield run
    for each in started:
        each.arrangement.stop()
        each.thread.join()


def test_a_reloaded_machine_begins_again_as_its_bundle_is(run: Callable[..., Running]) -> None:
    running = run()
    running.press("button")
    running.shows(lambda s: s.state == "On", "it is on")
    assert running.value("lamp") == 3, "what it was loaded with"
    will = running.board[will_slot("Lamp")].get()
    running.write(OTHER)
    status = running.ask()
    assert (status.state, status.refusal, status.suspended) == ("Dark", "", False)
    assert running.value("lamp") == 0, "the one that ran has ended"
    wait_for(lambda: running.value("bell") == 1, "the new one runs")
    running.press("switch")
    running.shows(lambda s: s.state == "Bright", "it reads a slot that it did not have")
    assert running.value("lamp") == 30
    states = running.board[definition_slot("Lamp")].get().states
    assert [each.name for each in states] == ["Dark", "Bright"]
    left = running.board[will_slot("Lamp")].get()
    assert (left.state, left.values != will.values) == ("left", True)
    (claim,) = running.board[commanders_slot("bell")].get().commanders
    assert claim.machine == "Lamp"
    assert running.status.get().ringlets > status.ringlets > 0, "its turns are counted on"
    running.arrangement.stop()
    running.thread.join()
    assert (running.value("lamp"), running.value("bell")) == (0, 7)
    left = running.board.get_message(will_slot("Lamp"))
    assert left is None or not left.values


WRONG = {
    "syntax": ({"State_Off_OnEntry.py": "lamp(\n"}, "State_Off_OnEntry.py:1: "),
    "field": ({"State_Off_OnEntry.py": "lamp(Int32(dta=1))\n"}, "'dta'"),
    "include": (
        {"Lamp_Includes.py": FILES["Lamp_Includes.py"] + "raise SystemExit('no')\n"},
        "SystemExit",
    ),
    "value": (
        {"Lamp_Variables.py": FILES["Lamp_Variables.py"] + "up: int = 1 // 0\n"},
        "Lamp_Variables.py:4",
    ),
    "variable": (OTHER | {"Lamp_Variables.py": OTHER["Lamp_Variables.py"][:-15]}, "'level'"),
    "type": (
        {"Lamp_Variables.py": FILES["Lamp_Variables.py"].replace("'lamp'", "'button'")},
        "'button'",
    ),
}


@pytest.mark.parametrize(("files", "why"), WRONG.values(), ids=WRONG)
def test_a_bundle_with_an_error_leaves_the_one_that_runs(
    run: Callable[..., Running], files: dict[str, str], why: str
) -> None:
    running = run()
    definition, will = (running.board[slot("Lamp")].count for slot in (definition_slot, will_slot))
    running.write(files)
    status = running.ask()
    assert why in status.refusal
    assert status.state == "Off"
    running.press("button")
    running.shows(lambda s: s.state == "On", "it still reads and posts")
    assert running.value("lamp") == 3
    assert running.board[definition_slot("Lamp")].count == definition
    assert running.board[will_slot("Lamp")].count == will
    running.write(FILES)
    assert running.ask().refusal == ""


def test_an_exclusive_slot_that_another_machine_has_is_refused(
    run: Callable[..., Running], shared: Whiteboard, tmp_path: Path
) -> None:
    running = run()
    with Whiteboard("board", directory=tmp_path) as theirs:
        environment = LiveEnvironment(theirs)
        other = Arrangement(environment=environment)
        text = OTHER["Lamp_Variables.py"].replace("Int32(7)", "Int32(7), exclusive=True")
        running.write({**OTHER, "Lamp_Variables.py": text})
        other.load(load_bundle(running.folder), name="Other")
        assert "bell" in running.ask().refusal
        claims = shared[commanders_slot("lamp")].get().commanders
        assert sorted(each.machine for each in claims) == ["Lamp", "Other"]
        other.end()
    assert running.ask().refusal == ""


def test_turns_are_given_while_a_bundle_is_loaded(
    run: Callable[..., Running], tmp_path: Path
) -> None:
    running, gate = run(), tmp_path / "gate"
    os.mkfifo(gate)
    running.write({"Lamp_Includes.py": waiting_for(gate)})
    Directory(running.board).find("Lamp").request("reload")
    before = running.shows(lambda s: s.pending == "reload", "it is being loaded").ringlets
    running.shows(lambda s: s.ringlets > before + 10, "it has its turns")
    status = running.shows(lambda s: s.pending == "reload", "still")
    Directory(running.board).find("Lamp").request("reload")
    running.shows(lambda s: s.obeyed > status.obeyed, "another request has come")
    assert "still being loaded" in running.status.get().refusal
    gate.write_text("")
    running.shows(lambda s: not s.pending and s.state == "Off", "it is loaded")


@pytest.mark.parametrize("action", ["suspend", "restart"])
def test_a_later_request_replaces_a_reload(
    run: Callable[..., Running], tmp_path: Path, action: str
) -> None:
    running, gate = run(), tmp_path / "gate"
    os.mkfifo(gate)
    includes = waiting_for(gate)
    running.write({**OTHER, "Lamp_Includes.py": includes})
    Directory(running.board).find("Lamp").request("reload")
    running.shows(lambda s: s.pending == "reload", "it is being loaded")
    status = running.ask(action)
    assert (status.suspended, status.refusal != "") == (action == "suspend", True)
    gate.write_text("")
    running.write(FILES | OTHER)
    ringlets = running.status.get().ringlets
    running.shows(lambda s: s.ringlets > ringlets + 20, "it goes on")
    assert running.status.get().state in ("Off", "Suspended")
    wait_for(lambda: running.ask().refusal == "", "and can be reloaded")
    assert running.shows(lambda s: not s.suspended, "it runs").state == "Dark"


def test_one_that_is_suspended_meanwhile_stays_so(
    run: Callable[..., Running], tmp_path: Path
) -> None:
    running, gate = run(), tmp_path / "gate"
    os.mkfifo(gate)
    running.write({"Lamp_Includes.py": waiting_for(gate)})
    Directory(running.board).find("Lamp").request("reload")
    running.shows(lambda s: s.pending == "reload", "it is being loaded")
    running.arrangement.suspend("Lamp")  # as another machine's code may
    running.shows(lambda s: s.suspended, "it is suspended")
    gate.write_text("")
    status = running.shows(lambda s: not s.pending, "the reload is over")
    assert "suspended" in status.refusal
    assert status.suspended


def test_a_failed_machine_is_reloaded(run: Callable[..., Running]) -> None:
    running = run(on_error="suspend", timed=True)
    running.write({"State_Off_OnEntry.py": "level // (level - level)\n"})
    assert running.ask().refusal == ""
    running.shows(lambda s: s.failed, "its new code has failed")
    assert running.value("lamp") == -1
    running.write(OTHER)
    status = running.ask()
    assert (status.failed, status.state, status.suspended) == (False, "Dark", False)
    wait_for(lambda: running.value("bell") == 1, "it has run")
    running.arrangement.stop()
    running.thread.join()
    times = running.arrangement.statistics()[1].state_s
    assert {"Off", "Dark"} <= times.keys(), "of the one that ran, too"


def test_a_class_is_not_reloaded(run: Callable[..., Running]) -> None:
    running = run()
    Directory(running.board).find("Idle").request("reload")
    wait_for(lambda: running.board[status_slot("Idle")].get().refusal, "it is refused")
    assert "only a .machine bundle" in running.board[status_slot("Idle")].get().refusal


def test_a_machine_whose_journal_is_kept_is_not_reloaded(folder: Path) -> None:
    environment = JournalledEnvironment(BoardEnvironment(Whiteboard.local()), Journal(id))
    cls = load_bundle(folder)
    with Arrangement([cls], environment=environment) as arrangement:
        before = arrangement.machine("Lamp")
        with pytest.raises(LoadError, match="end the recording first"):
            arrangement.reload("Lamp", cls)
        reloads = Reloads(arrangement)
        reloads.begin("Lamp")
        assert "end the recording first" in reloads.refusal("Lamp")
        assert not reloads.is_pending("Lamp")
        assert arrangement.machine("Lamp") is before


def test_an_override_ends_with_the_machine_that_it_was_for(folder: Path) -> None:
    board = Whiteboard.local()
    arrangement = Arrangement([load_bundle(folder)], whiteboard=board, clock=ManualClock())
    Debugger(arrangement).override("Lamp", "button", '{"data": true}')
    arrangement.reload("Lamp", load_bundle(folder))
    assert arrangement.roster.find("Lamp").overridden == ()
    arrangement.round()
    arrangement.round()
    assert arrangement.state_name_of("Lamp") == "Off"


def test_what_is_loaded_later_is_the_latest(folder: Path) -> None:
    first = load_bundle(folder)
    arrangement = Arrangement([first], whiteboard=Whiteboard.local(), library={"Lamp": first})
    for name, text in OTHER.items():
        (folder / name).write_text(text)
    arrangement.reload("Lamp", load_bundle(folder))
    arrangement.load("Lamp")
    assert arrangement.state_name_of("Lamp.0") == "Dark"
