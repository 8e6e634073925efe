"""The simulation of a machine that is edited: one for all windows, in a process of its own.

The machine runs under a manual clock, alone on a board; it is stepped, fed and described as the
page shows it. Its code may fail, hang or end its process, so the page's server asks a worker.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

import msgspec

from llfsm.bridges.view.errors import RequestError
from llfsm.bridges.view.page_requests import NumberedRequest
from llfsm.errors import LlfsmError
from llfsm.runtime import Arrangement, ManualClock, Trace
from llfsm.runtime.converting.class_process import load_machine
from llfsm.runtime.engine.errors import ExecutionError, FsmError
from llfsm.runtime.engine.events import Eval, Event, Observer
from llfsm.runtime.testing import states_of
from llfsm.runtime.testing.waiting import next_round_ns
from llfsm.runtime.value_text import ValueText
from llfsm.runtime.worker import Worker, WorkerError
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.message_text import parse_message
from llfsm.whiteboard.schema import to_plain

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
        """True if no round is left: the machine has accepted or failed."""
        return bool(self._error) or self._arrangement.finished

    def sensors(self) -> list[dict[str, Any]]:
        """Describe the machine's sensors: names, slots, their schemas, and values as arrays."""
        found: list[dict[str, Any]] = []
        for name, sensor in self._sensors.items():
            slot, value = sensor.slot, sensor.default
            if value is None:
                value = parse_message(slot, "{}")
            shown = {"name": name, "slot": slot.name, "schema": slot.schema}
            found.append({**shown, "value": msgspec.to_builtins(value)})
        return found

    def opening(self) -> dict[str, Any]:
        """Describe the machine and its sensors, for a simulation that has not begun."""
        return {"sensors": self.sensors(), "simulation": self.describe()}

    def perform(self, name: str, *arguments: Any) -> dict[str, Any]:
        """Call another method; describe the machine after it."""
        getattr(self, name)(*arguments)
        return {"simulation": self.describe()}

    def describe(self) -> dict[str, Any]:
        """Describe the place of the machine, as the page shows it."""
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


_START_S = 30.0  # for the imports of the machine, too


class SimulationProcess:
    """The worker in which a machine is simulated, found as by `load_machine`, as it is there now.

    It is asked in a thread, one question at a time. Code of the machine that runs for longer than
    `patience_s` seconds is taken for an endless loop, and ended.
    """

    def __init__(self, worker: Worker, *, patience_s: float = 5.0):
        self._worker = worker
        self._patience_s = patience_s
        self._turn = asyncio.Lock()

    @classmethod
    async def start(cls, found_by: list[str], *, patience_s: float = 5.0) -> SimulationProcess:
        """Load the machine in a new worker; raise `RequestError` if it cannot be run."""
        started = cls(Worker("the machine's code"), patience_s=patience_s)
        make = partial(started._worker.make, SimulatedMachine, found_by, patience_s=_START_S)
        try:
            await started._asked(make)
        except BaseException:
            await started.end()
            raise
        return started

    @property
    def has_ended(self) -> bool:
        """True once the process was ended, or was found to have ended."""
        return self._worker.has_ended

    async def ask(self, name: str, *arguments: Any) -> Any:
        """Call a method of the `SimulatedMachine`; raise `RequestError` with what it raises."""
        async with self._turn:
            if self.has_ended:
                raise RequestError("the simulation has ended")
            call = self._worker.call
            return await self._asked(partial(call, name, *arguments, patience_s=self._patience_s))

    async def end(self) -> None:
        """Kill the process, and wait until it has gone."""
        self._worker.kill()
        async with self._turn:
            await asyncio.to_thread(self._worker.close)

    async def _asked(self, ask: Callable[[], Any]) -> Any:
        try:
            return await asyncio.to_thread(ask)
        except WorkerError as error:
            raise RequestError(f"{error}; simulation ended") from None
        except (LlfsmError, OSError) as error:
            raise RequestError(str(error)) from None
        except BaseException:  # an answer that nobody takes would be taken for the next one
            self._worker.kill()
            raise


_FRAME_S = 0.05  # between two looks at a running simulation
_FASTEST = 100.0


class StartSimulation(NumberedRequest, tag="simulate"):
    """Run the machine's text as it is now, from the beginning."""


class StepSimulation(NumberedRequest, tag="step"):
    """Run one round, or until the machine is in another state."""

    until: Literal["round", "state"]


class RunSimulation(NumberedRequest, tag="run"):
    """Run at so many times real time; 0 pauses."""

    speed: float


class PostSimulated(NumberedRequest, tag="post"):
    """Post a message, as a JSON object, to a slot that the machine reads."""

    slot: str
    message: msgspec.Raw


class SaveSimulation(NumberedRequest, tag="save"):
    """Save all that was done as a test; its text is the answer."""


class EndSimulation(NumberedRequest, tag="end"):
    """End the simulation."""


SimulationRequest: TypeAlias = (
    StartSimulation
    | StepSimulation
    | RunSimulation
    | PostSimulated
    | SaveSimulation
    | EndSimulation
)


class Simulating:
    """The simulation of a bundle, if there is one; `publish` sends data to all windows."""

    def __init__(self, found_by: list[str], publish: Callable[[dict[str, Any]], Awaitable[None]]):
        self._found_by = found_by
        self._publish = publish
        self._process: SimulationProcess | None = None
        self._running: asyncio.Task[None] | None = None
        self._speed = 0.0

    async def perform(self, request: SimulationRequest) -> str:
        """Carry out a request and return what was done, or raise `RequestError`."""
        if isinstance(request, StartSimulation):
            return await self._start()
        if isinstance(request, EndSimulation):
            await self.end()
            await self._publish({"simulation": None})
            return "simulation ended"
        if isinstance(request, SaveSimulation):
            return str(await self._ask("test_text"))
        if isinstance(request, RunSimulation):
            return await self._run(request.speed)
        if isinstance(request, PostSimulated):
            await self._perform("post", request.slot, bytes(request.message).decode())
            return f"posted to {request.slot}"
        await self._perform("round" if request.until == "round" else "until_state")
        return "stepped"

    async def end(self) -> None:
        """End the process, if there is one."""
        running, process = self._running, self._process
        self._running = self._process = None
        self._speed = 0.0
        if running is not None:
            running.cancel()
        if process is not None:
            await process.end()

    async def _start(self) -> str:
        await self.end()
        process = await SimulationProcess.start(self._found_by)
        await self.end()  # one that another window has started meanwhile
        self._process = process
        await self._show(await self._ask("opening"))
        return "simulation started"

    async def _run(self, speed: float) -> str:
        if not (math.isfinite(speed) and 0 <= speed <= _FASTEST):
            raise RequestError(f"a speed of {speed} is not in 0 to {_FASTEST:g}")
        self._speed = speed
        if speed and (self._running is None or self._running.done()):
            self._running = asyncio.create_task(self._advance())
        await self._perform("advance", 0)
        return f"speed {speed:g}"

    async def _advance(self) -> None:
        clock = asyncio.get_running_loop()
        last_s = clock.time()
        while self._speed:
            await asyncio.sleep(_FRAME_S)
            now_s = clock.time()
            try:
                await self._perform("advance", (now_s - last_s) * 1e3 * self._speed)
            except RequestError:
                self._speed = 0.0  # the page shows why
            last_s = now_s

    async def _perform(self, name: str, *arguments: Any) -> None:
        """Let the machine do something, and show all windows how it stands then."""
        await self._show(await self._ask("perform", name, *arguments))

    async def _show(self, shown: dict[str, Any]) -> None:
        if shown["simulation"]["over"]:
            self._speed = 0.0
        shown["simulation"]["speed"] = self._speed
        await self._publish(shown)

    async def _ask(self, name: str, *arguments: Any) -> Any:
        process = self._process
        if process is None:
            raise RequestError("no simulation: press Simulate first")
        try:
            return await process.ask(name, *arguments)
        except RequestError as error:
            if process.has_ended:
                await process.end()
            if process.has_ended and self._process is process:
                self._process, self._speed = None, 0.0
                await self._publish({"simulation": {"over": True, "error": str(error)}})
            raise
