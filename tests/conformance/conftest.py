"""Play a scenario: build its machines through the public API and return its trace as data.

A scenario is a JSON object: `options`, `machines`, `library`. A machine has `name`, `initial`
(the first state), `suspend_state`, `start_suspended` and `states`; a state has lists of ops under
the names of its sections and `transitions` in order. See the README beside the scenarios.
"""

from __future__ import annotations

import warnings
from typing import Any

import pytest

from llfsm.runtime import (
    Arrangement,
    Machine,
    ManualClock,
    State,
    UnknownMachineError,
    UnreachableStateWarning,
    define,
)
from llfsm.runtime.engine import events as ev

# What clfsm returns for a name that is no machine, where the runtime raises
CLFSM_UNKNOWN = {"is_suspended": False, "is_running": True, "abandon": False, "unload": False}


class Player:
    """One run of a scenario. `clfsm_names` makes unknown names return what clfsm does."""

    def __init__(self, scenario: dict[str, Any], clfsm_names: bool):
        self.options = scenario["options"]
        self.clfsm_names = clfsm_names
        self.clock = ManualClock()
        self.trace: list[dict[str, Any]] = []
        specs = [*scenario["machines"], *scenario.get("library", [])]
        classes = {spec["name"]: self.machine_class(spec) for spec in specs}
        started = {s: [] for s in (False, True)}
        for spec in scenario["machines"]:
            started[spec["start_suspended"]].append(classes[spec["name"]])
        self.arrangement = Arrangement(
            started[False],
            start_suspended=started[True],
            clock=self.clock,
            idle_us=self.options["idle_us"],
            unload_accepting=self.options["unload_accepting"],
            library=classes,
        )

    def run(self) -> list[dict[str, Any]]:
        """Run it observed and return the trace."""
        self.arrangement.attach(self.record)
        self.arrangement.run(max_rounds=self.options["max_rounds"])
        return self.trace

    def step(self) -> None:
        """Run it by single rounds and unobserved."""
        while True:
            fired = self.arrangement.round()
            self.clock.advance(us=self.options["clock_per_round_us"])
            if self.arrangement.rounds == self.options["max_rounds"]:
                break
            if not fired:
                self.clock.advance(us=self.options["idle_us"])
            if self.arrangement.finished:
                break

    def standing(self) -> dict[str, Any]:
        """Return where all has come to."""
        arrangement = self.arrangement
        return {"rounds": arrangement.rounds, "t": self.clock.now_ns()} | {
            m.name: (arrangement.control.index_of(m.name), m.state_name, arrangement.status(m.name))
            for m in arrangement.machines
        }

    # The machines

    def machine_class(self, spec: dict[str, Any]) -> type[Machine]:
        names = [spec["initial"], *(s["name"] for s in spec["states"])]
        states = {name: State(name, suspend=name == spec["suspend_state"]) for name in names}
        for state_spec in spec["states"]:
            state = states[state_spec["name"]]
            for section, declare in {
                "OnEntry": state.on_entry,
                "OnExit": state.on_exit,
                "Internal": state.internal,
                "OnSuspend": state.on_suspend,
                "OnResume": state.on_resume,
            }.items():
                declare(self.section(state.name, state_spec[section]))
            for transition in state_spec["transitions"]:
                state.to(states[transition["target"]], when=self.guard(transition["cond"]))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnreachableStateWarning)
            return define(spec["name"], states.values())

    def section(self, state: str, ops: list[dict[str, Any]]) -> Any:
        def run(machine: Machine) -> None:
            for op in ops:
                if self.holds(machine, op.get("when", True)):
                    self.operate(machine, state, op)

        return run

    def guard(self, cond: Any) -> Any:
        return lambda machine: self.holds(machine, cond)

    def operate(self, machine: Machine, state: str, op: dict[str, Any]) -> None:
        name, argument = op["op"], op.get("m")
        if name == "advance_us":
            self.clock.advance(us=op["n"])
        elif name == "number_of_machines":
            assert machine.number_of_machines > 0
        elif argument is None:
            getattr(machine, name)()
        else:
            try:
                getattr(machine, name)(argument)
            except UnknownMachineError:
                result = CLFSM_UNKNOWN.get(name, -1) if self.clfsm_names else "unknown"
                stamp = self.arrangement.kernel.stamp()
                self.record(ev.Call(*stamp, machine.name, state, name, argument, result))

    def holds(self, machine: Machine, cond: Any) -> bool:
        if isinstance(cond, bool):
            return cond
        ((kind, value),) = cond.items()
        rounds = self.arrangement.rounds
        match kind:
            case "after_ms":
                return machine.after_ms(value)
            case "after":
                return machine.after(value)
            case "round_eq":
                return rounds == value
            case "round_ge":
                return rounds >= value
            case "round_in":
                return rounds in value
            case "not":
                return not self.holds(machine, value)
            case "and":
                return all(self.holds(machine, c) for c in value)
            case "is_suspended" | "is_running":
                try:  # asked from outside, where no Call is reported
                    return getattr(self.arrangement.control, kind)(value)
                except UnknownMachineError:
                    return CLFSM_UNKNOWN[kind]
        raise AssertionError(f"unknown condition {kind}")

    # The trace

    def record(self, event: ev.Event) -> None:
        self.trace.append({"round": event.round, "t": event.time_ns // 1000, **as_data(event)})
        if isinstance(event, ev.RoundEnd):
            self.clock.advance(us=self.options["clock_per_round_us"])


def as_data(event: ev.Event) -> dict[str, Any]:
    match event:
        case ev.Turn():
            return {
                "sec": "Turn",
                "i": event.index,
                "m": event.machine,
                "state": event.state,
                "prev": event.previous,
                "scheduled": event.request or "none",
            }
        case ev.Section():
            return {"sec": event.section, "m": event.machine, "state": event.state}
        case ev.Eval():
            return {
                "sec": "Eval",
                "m": event.machine,
                "state": event.state,
                "tr": event.transition,
                "target": event.target,
                "val": event.value,
            }
        case ev.Call():
            argument = {} if event.argument is None else {"arg": event.argument}
            return {
                "sec": "Call",
                "m": event.machine,
                "state": event.state,
                "op": event.operation,
                **argument,
                "ret": event.result,
            }
        case ev.Accepting():
            return {
                "sec": "Accepting",
                "i": event.index,
                "m": event.machine,
                "action": event.action,
            }
        case ev.RoundEnd():
            return {
                "sec": "RoundEnd",
                "fired": event.fired,
                "accepting": event.accepting,
                "machines": [status_as_data(i, m) for i, m in enumerate(event.machines)],
            }
        case ev.IdleSleep():
            return {"sec": "IdleSleep", "us": event.duration_ns // 1000}
        case ev.End():
            return {"sec": "End", "reason": event.reason}
    return {"sec": type(event).__name__}


def status_as_data(index: int, status: ev.Standing | None) -> dict[str, Any]:
    if status is None:
        return {"i": index, "m": "<unloaded>", "state": None}
    return {
        "i": status.index,
        "m": status.machine,
        "state": status.state,
        "suspended": status.suspended,
        "scheduled": status.request or "none",
        "state_time": None if status.entered_ns is None else status.entered_ns // 1000,
    }


@pytest.fixture(scope="session")
def player() -> Any:
    """Return the function that prepares a scenario: run it, or step through it."""

    def prepare(scenario: dict[str, Any], *, clfsm_names: bool = True) -> Player:
        return Player(scenario, clfsm_names)

    return prepare


@pytest.fixture
def run(player: Any) -> Any:
    """Return the function that plays machines as `written` describes them; it returns the trace."""

    def play(*machines: dict[str, Any], rounds: int = 9, **options: Any) -> list[dict[str, Any]]:
        library = options.pop("library", [])
        defaults = {"unload_accepting": True, "idle_us": 10_000, "clock_per_round_us": 0}
        return player(
            {
                "options": defaults | options | {"max_rounds": rounds},
                "machines": list(machines),
                "library": library,
            }
        ).run()

    return play
