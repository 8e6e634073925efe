"""A machine of a bundle under a manual clock: stepped, fed and described as the page shows it."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from llfsm.runtime import Arrangement, ManualClock, Trace
from llfsm.runtime.converting.class_process import load_machine
from llfsm.runtime.engine.errors import ExecutionError, FsmError
from llfsm.runtime.engine.events import Eval, Event, Observer
from llfsm.runtime.testing import states_of
from llfsm.runtime.testing.waiting import next_round_ns
from llfsm.runtime.value_text import ValueText
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.message_text import parse_message
from llfsm.whiteboard.schema import to_plain

__all__ = ["SimulatedMachine"]

_BUDGET_S = 0.25  # of the host's time, after which `advance` returns though less has passed
_LONGEST_TEXT = 200  # characters of a variable's value
_LONGEST_NS = 60_000_000_000  # simulated, in which `until_state` waits for another state

_TEST = '''\
"""What was simulated of {name}. Keep it beside {file}."""

{before}from llfsm.runtime import Arrangement, ManualClock, Trace
{within}from llfsm.runtime.testing import SensorScript, assert_states, run_until
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.message_text import parse_message
{behind}

def test_{name}() -> None:
    machine = {machine}
    slots = {{port.slot.name: port.slot for port in machine.table.sensors.values()}}
    posted = [
{posts}    ]
    script = [(ms, slots[name], parse_message(slots[name], text)) for ms, name, text in posted]
    clock, trace = ManualClock(), Trace()
    board = LocalBoard(now_ns=clock.now_ns)
    observers = [SensorScript(board, script), trace]
    arrangement = Arrangement([machine], whiteboard=board, clock=clock, observers=observers)
    with arrangement:
        run_until(arrangement, lambda now: now.rounds == {rounds}, within_ms={within_ms})
    states = [
{states}    ]
    assert_states(trace, {name!r}, states)
'''


class SimulatedMachine:
    """The machine in a bundle, alone on a board of its own; its text is run.

    The clock always stands at the next round, so what is posted is read by that. Rounds follow each
    other as in `run_until`. Raise `BundleError` or `DefinitionError` for a machine that cannot run.
    """

    def __init__(self, found_by: Sequence[str]):
        self._found_by = found_by
        machine = load_machine(found_by)
        self._sensors = machine.table.sensors
        self._slots = {port.slot.name: port.slot for port in self._sensors.values()}
        self._posting = {port.slot.name: port.slot for port in machine.table.actuators.values()}
        self._clock, self._trace = ManualClock(), Trace()
        self._board = LocalBoard(now_ns=self._clock.now_ns)
        observers: list[Observer] = [self._trace, self._note]
        self._arrangement = Arrangement(
            [machine], whiteboard=self._board, clock=self._clock, observers=observers
        )
        [self._machine] = self._arrangement.machines
        self._posted: list[tuple[float, str, str]] = []  # ms, slot, message
        self._fired: tuple[str, int] | None = None
        self._error = ""

    def _note(self, event: Event) -> None:
        if isinstance(event, Eval) and event.value and event.machine == self._machine.name:
            self._fired = (event.state, event.transition)

    @property
    def is_over(self) -> bool:
        """Whether no round is left: the machine has accepted or failed."""
        return bool(self._error) or self._arrangement.finished

    def sensors(self) -> list[dict[str, Any]]:
        """Return what the machine reads: names, slots, their schemas, and values as arrays."""
        found: list[dict[str, Any]] = []
        for name, sensor in self._sensors.items():
            slot, value = sensor.slot, sensor.default
            if value is None:
                value = parse_message(slot, "{}")
            shown = {"name": name, "slot": slot.name, "schema": slot.schema}
            found.append({**shown, "value": msgspec.to_builtins(value)})
        return found

    def describe(self) -> dict[str, Any]:
        """Return where the machine stands, as the page shows it."""
        text, machine = ValueText(_LONGEST_TEXT).text, self._machine
        variables = type(machine).table.variables
        read = {name: self._board[slot].get() for name, slot in self._slots.items()}
        posted = {}
        for name, slot in self._posting.items():
            message = self._board[slot].get()
            if message is not None:
                posted[name] = json.dumps(to_plain(message))
        return {
            "time_ms": self._clock.now_ns() / 1e6,
            "rounds": self._arrangement.rounds,
            "state": self._machine.state_name,
            "fired": self._fired,
            "over": self.is_over,
            "error": self._error,
            "variables": [(name, text(getattr(machine, name))) for name in variables],
            "posted": posted,
            "read": {n: msgspec.to_builtins(each) for n, each in read.items() if each is not None},
        }

    def post(self, slot: str, text: str) -> None:
        """Post a message, as a JSON object, to a slot that the machine reads."""
        if slot not in self._slots:
            raise FsmError(f"{self._machine.name} reads no slot {slot!r}")
        self._board.add_message(self._slots[slot], parse_message(self._slots[slot], text))
        now_ms = self._clock.now_ns() / 1e6
        at = len(self._posted)
        while at and self._posted[at - 1][0] == now_ms:
            at -= 1
        unread = {each[1]: each for each in self._posted[at:]}  # only the last of a slot is
        self._posted[at:] = (unread | {slot: (now_ms, slot, text)}).values()

    def round(self) -> None:
        """Run one round, which is a turn of the machine; none if it is over."""
        if self.is_over:
            return
        now_ns = self._clock.now_ns()
        try:
            fired = self._arrangement.round()
        except ExecutionError as error:
            self._error = str(error)
        else:
            self._clock.sleep_until_ns(next_round_ns(self._arrangement, now_ns, fired))

    def until_state(self) -> None:
        """Run until the machine is in another state, or a minute has passed."""
        before, begin_ns = self._machine.state_name, self._clock.now_ns()
        while not self.is_over and self._clock.now_ns() - begin_ns < _LONGEST_NS:
            self.round()
            if self._machine.state_name != before:
                return

    def advance(self, ms: float) -> None:
        """Run the rounds of so many milliseconds, or as many as the host has time for."""
        end_ns, stop_s = self._clock.now_ns() + round(ms * 1e6), time.monotonic() + _BUDGET_S
        while not self.is_over and self._clock.now_ns() < end_ns and time.monotonic() < stop_s:
            self.round()

    def test_text(self) -> str:
        """Return a test of the testing kit that does the same and expects the same states."""
        if self._error:
            raise FsmError("the machine has failed; a test of it would fail, too")
        if not self._arrangement.rounds:
            raise FsmError("nothing has been simulated yet: press Step or Run first")
        name = self._machine.name
        posts = [f"        ({ms:.15g}, {slot!r}, {text!r}),\n" for ms, slot, text in self._posted]
        states = [f"        {state!r},\n" for state in states_of(self._trace, name)]
        where, *names = self._found_by
        file = Path(where).name
        if names:
            before, within, behind = "", "", f"\nfrom {names[0]} import {name}\n"
            machine = name
        else:
            before, behind = "from pathlib import Path\n\n", ""
            within = "from llfsm.runtime.bundles import load_bundle\n"
            machine = f"load_bundle(Path(__file__).parent / {file!r})"
        return _TEST.format(
            name=name,
            file=file,
            before=before,
            within=within,
            behind=behind,
            machine=machine,
            posts="".join(posts),
            rounds=self._arrangement.rounds,
            within_ms=self._clock.now_ns() // 1_000_000 + 1,
            states="".join(states),
        )
