"""Scripts: the messages and requests that machines get, by rounds and turns, on a manual clock.

A script decides all that machines can depend on. Each step lets time pass, which the manual clock
knows alone, posts messages, and runs a round. Messages and requests can also come just before one
machine's turn, as they do in an exploration and in a run: messages when the machine's first sensor
is read, requests when its turn begins. So a counterexample with any interleaving is a script.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.clock import ManualClock
from llfsm.runtime.engine.environment import AgedRead, Read
from llfsm.runtime.engine.errors import UnknownMachineError
from llfsm.runtime.engine.events import Event, Status, Turn
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.runtime.testing.errors import ScriptError
from llfsm.whiteboard import Slot
from llfsm.whiteboard.local import LocalBoard

if TYPE_CHECKING:
    from llfsm.runtime.engine.environment import Elsewhere
    from llfsm.runtime.engine.ports import Sensor


_NOTHING: Mapping[Any, Any] = MappingProxyType({})


Ask: TypeAlias = Literal["suspend", "resume", "restart", "stop"]
Answers: TypeAlias = Mapping[str, Sequence[tuple[str, bool] | None]]
TurnOf: TypeAlias = str | tuple[str, int]
"""A machine's turn in a round: its name for the first, or with the number of another one."""


def turn_of(machine: str, number: int) -> TurnOf:
    """Name a machine's turn in a round, of which the first has the number 1."""
    return machine if number == 1 else (machine, number)


class Step(NamedTuple):
    """Let `wait_ms` pass, post `messages`, and run one round.

    With `most_rounds`, the next round follows at once while transitions fire, as in
    `Arrangement.run`, until there were so many: the manual clock stands still meanwhile.

    Just before the turn of a machine that `before` or `asks` names, more messages are posted, or
    it is asked to "suspend", "resume" or "restart", or all machines to "stop"; what `after` has is
    asked when the round is over. None instead of a message empties a slot, as if nothing had been
    posted. `elsewhere` answers a machine's questions for those of other processes in its turn, in
    order: with ("STATE", False), or True if it is suspended, or None if there is none of the name.

    With a timetable, a round is a cycle, the time until each turn is due passes by itself,
    and ("Machine", 2) names a machine's second turn in it.
    """

    wait_ms: float = 0
    messages: Mapping[Slot[Any], Any] = _NOTHING
    before: Mapping[TurnOf, Mapping[Slot[Any], Any]] = _NOTHING
    asks: Mapping[TurnOf, Sequence[Ask]] = _NOTHING
    after: Mapping[str, Sequence[Ask]] = _NOTHING
    most_rounds: int = 1
    elsewhere: Mapping[TurnOf, Answers] = _NOTHING


class _Answering(NamedTuple):
    """A machine of another process, as a script has it."""

    state: str
    suspended: bool

    def request(self, action: Literal["suspend", "resume", "restart"]) -> Status:
        """Return its status; nobody is asked."""
        return Status.SUSPENDED if self.suspended else Status.RUNNING


class _ScriptedAgedRead:
    """Read a sensor whose slot the script may have emptied."""

    def __init__(self, aged: AgedRead, read: Read):
        self.start_count = aged.start_count
        self._aged = aged
        self._read = read

    def __call__(self) -> object:
        return self._read()

    def age_ns(self) -> int | None:
        """Return the age of the message that was read last, in nanoseconds; None without one."""
        return self._aged.age_ns()


class ScriptedEnvironment(LiveEnvironment):
    """An environment with a board of its own to which a script posts, and a manual clock."""

    clock: ManualClock
    whiteboard: LocalBoard

    def __init__(self, start_ns: int = 0):
        clock = ManualClock(start_ns)
        super().__init__(LocalBoard(now_ns=clock.now_ns), clock)
        self.asking: Callable[[], AbstractContextManager[None]] = nullcontext
        """Entered while the script makes its requests, so that a journal can tell them apart."""
        self.machines: dict[str, Machine] = {}
        """All machines that were loaded, by name, also those that have left."""
        self._arrangement: Arrangement | None = None
        self._before: dict[TurnOf, Mapping[Slot[Any], Any]] = {}
        self._turns: Counter[str] = Counter()  # in this round
        self._answers: dict[str, list[tuple[str, bool] | None]] = {}  # in this turn
        self._emptied: dict[str, int] = {}  # slot -> the count up to which it counts as empty

    def play(self, arrangement: Arrangement, script: Iterable[Step]) -> Iterator[Step]:
        """Do a script, and yield each step when its rounds are over; raise `ScriptError`."""
        for step in script:
            if step.wait_ms < 0:
                raise ScriptError(f"a step waits {step.wait_ms} ms; it must be 0 or more")
            self.clock.advance(ms=step.wait_ms)
            self._post(step.messages)
            self._before = {**step.before}
            with self._asking(arrangement, step):
                for _ in range(step.most_rounds):
                    self._turns.clear()
                    if not arrangement.round() or arrangement.finished:
                        break
            for machine, asked in step.after.items():
                self._ask(arrangement, machine, asked)
            yield step

    @contextmanager
    def _asking(self, arrangement: Arrangement, step: Step) -> Iterator[None]:
        """Make a step's requests while this is entered, each at the beginning of a turn."""

        def ask(event: Event) -> None:
            if isinstance(event, Turn):
                self._turns[event.machine] += 1
                turn = turn_of(event.machine, self._turns[event.machine])
                answers = step.elsewhere.get(turn, _NOTHING)
                self._answers = {name: [*each] for name, each in answers.items()}
                self._ask(arrangement, event.machine, step.asks.get(turn, ()))

        if step.asks or step.before or step.elsewhere:
            arrangement.attach(ask)
        yield
        arrangement.detach(ask)
        self._answers = {}

    def _ask(self, arrangement: Arrangement, machine: str, asked: Sequence[Ask]) -> None:
        with self.asking():
            for action in asked:
                if action == "stop":
                    arrangement.stop("the script asks for it")
                    arrangement.kernel.show_stop()
                elif action == "suspend":
                    arrangement.control.hold(machine)  # as from another process
                else:
                    getattr(arrangement.control, action)(machine)

    def content(self, slot: Slot[Any]) -> Any:
        """Return the latest message of a slot; None if it is empty or the script emptied it."""
        bound = self.whiteboard[slot]
        return None if self._emptied.get(slot.name) == bound.count else bound.get()

    def enter(self, arrangement: Arrangement) -> None:
        """Keep the arrangement, to know its machines."""
        super().enter(arrangement)
        self._arrangement = arrangement

    def loaded(self, machine: str, path: str) -> None:
        """Keep a machine that was loaded."""
        super().loaded(machine, path)
        assert self._arrangement is not None
        self.machines[machine] = self._arrangement.machine(machine)

    def read(self, machine: str, name: str, sensor: Sensor[Any, Any], slot: Slot[Any]) -> Read:
        """Make a function that reads a slot, after posting the script's messages for this turn."""
        return self._reading(machine, slot, self._reader(machine, slot).get)

    def _reading(self, machine: str, slot: Slot[Any], get: Read) -> Read:
        reader = self._reader(machine, slot)

        def read() -> object:
            turn = turn_of(machine, self._turns[machine])
            if turn in self._before:
                self._post(self._before.pop(turn))
            return None if self._emptied.get(slot.name) == reader.count else get()

        return read

    def read_aged(
        self,
        machine: str,
        name: str,
        sensor: Sensor[Any, Any],
        slot: Slot[Any],
        start_count: int | None = None,
    ) -> AgedRead:
        """Make a function that reads as `read` does, and knows how old the message is."""
        aged = super().read_aged(machine, name, sensor, slot, start_count)
        return _ScriptedAgedRead(aged, self._reading(machine, slot, aged))

    def elsewhere(self, name: str, known: Iterable[str]) -> Elsewhere:
        """Return a machine of another process as the script has it, or as it is on the board."""
        answers = self._answers.get(name)
        if not answers:
            return super().elsewhere(name, known)
        answer = answers.pop(0)
        if answer is None:
            raise UnknownMachineError(name, known)
        return _Answering(*answer)

    def _post(self, messages: Mapping[Slot[Any], Any]) -> None:
        for slot, message in messages.items():
            if message is None:
                self._emptied[slot.name] = self.whiteboard[slot].count
            else:
                self.whiteboard.add_message(slot, message)
