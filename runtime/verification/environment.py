"""The environment of machines that are explored: it answers one ringlet, and notes what it asks.

A ringlet is a function of what it is given (`Given`): the machine's control state and variables,
the time in its state, the slots that it reads, and the control states of other machines. This
environment makes that true and as coarse as it can be:

* Time is opaque. All that code can do with it is to ask whether the machine has been in its state
  for longer than some limit. So one ringlet stands for all times that give the same answers, which
  are a range (`low_ns`, `high_ns`].
* A machine that goes on in place after a suspension does so with the time in that state until then.
  So a ringlet has two times, and may ask for one of them.
* Other machines are noted when code asks for them or changes them, so that a ringlet depends only
  on those that it has touched.
* A sensor with `max_age_ms` or `since_start` finds its message or none, as `contents` has it: who
  gives a ringlet its contents decides which messages are too old.
* A machine of another process that is declared answers each question as `contents` has it, by the
  machine that asks and the question's number in its turn: it may change from one to the next.
* Whatever else passes this door is refused, such as the age of a message in ms. The refusal holds
  even if the machine's code catches the error.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Set
from math import floor, inf, isfinite
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, NoReturn, Self, TypeAlias, cast

from llfsm.runtime.engine.clock import NEVER, Clock
from llfsm.runtime.engine.environment import Environment, Post, Read
from llfsm.runtime.engine.errors import UnknownMachineError
from llfsm.runtime.engine.events import Request, Status
from llfsm.runtime.verification.errors import UnsupportedError

if TYPE_CHECKING:
    from llfsm.runtime.engine.environment import AgedRead, Elsewhere
    from llfsm.runtime.engine.nest import RunStanding
    from llfsm.runtime.engine.ports import Actuator, Sensor
    from llfsm.runtime.engine.seat import Seat
    from llfsm.whiteboard import Slot


Since: TypeAlias = Literal["its entry", "this turn", "before the suspension"]
"""Since when a machine has been in the state whose time is asked for."""


class UnknownControlError(Exception):
    """A ringlet asked for more of machines than it was given.

    That is the control states of those in `touched`, the variables of inner ones in `looked`, and
    those that inner ones in `kept` had when they ended.
    """

    def __init__(self, touched: set[int], looked: set[int], kept: set[int]):
        self.touched = touched
        self.looked = looked
        self.kept = kept


class UnansweredError(Exception):
    """A ringlet asked for a machine of another process more often than it was given answers."""

    def __init__(self, machine: str):
        self.machine = machine


_MOST_QUESTIONS: Final = 8
"""Questions of a turn for one machine of another process."""


def question_slot(asking: str, machine: str, number: int) -> str:
    """Name what holds the answer to a machine's question for another one, which no slot is."""
    return f"{asking} asks {machine} ({number})"


class ControlState(NamedTuple):
    """A machine's control state: all that the engine keeps of it but its variables and time."""

    current: str
    previous: str | None
    remembered: str
    request: Request | None
    accepted: bool
    loaded: bool
    begun: bool
    """True once it has had a turn."""
    failed: bool = False
    """True if its code has raised, it was suspended for that, and not resumed since."""
    left: bool = False
    """True if the state that ran it was left before it was done; of others, before it is loaded."""
    parked: bool = False
    """True if it goes on when that state is entered again."""
    runs: tuple[RunStanding, ...] = ()
    """What its own states run, or have run last."""
    stood: bool = False
    """True if it is suspended in a state in which it goes on in place."""

    @classmethod
    def of(cls, seat: Seat) -> Self:
        """Read the control state of the machine in a seat."""
        return cls(
            seat.current.name,
            None if seat.previous is None else seat.previous.name,
            seat.remembered.name,
            seat.request,
            seat.accepted,
            seat.taken,
            seat.entered_ns != NEVER,
            seat.failure is not None,
            seat.left,
            seat.parking,
            seat.nest.standing,
            seat.stands,
        )

    @classmethod
    def shown(cls, seat: Seat) -> Self:
        """Read that of a machine that runs; an inner one that has ended is as at its begin."""
        control = cls.of(seat)
        if seat.caller is None or seat.taken or seat.parking or not seat.inner:
            return control
        initial = seat.initial.name
        return control._replace(
            current=initial,
            previous=None,
            remembered=initial,
            request=None,
            begun=False,
            stood=False,
        )

    def withdrawn_by(self, request: Request | None) -> bool:
        """Check for a pending restart, which `request` replaces only after a suspend."""
        return request is Request.RESUME and self.request is Request.RESTART

    @property
    def entered(self) -> bool:
        """True if it has had a turn in its state, so that the state's clock runs."""
        return self.current == self.previous and self.loaded


class Given(NamedTuple):
    """All that a ringlet can depend on: the machine's place, and the rest by numbers.

    Of a machine that goes on in place, `stood_ns` is the time in the state in which it stands.
    `contents` are the slots that it reads, `others` the machines whose control states it asks for
    or changes, and `inner` those whose variables it looks at. `request` comes from outside before
    the turn; `stopping` is True if a stop has come.
    """

    place: int
    control: int
    variables: int
    elapsed_ns: int
    stood_ns: int
    contents: tuple[tuple[str, int], ...]
    others: tuple[tuple[int, int], ...]
    inner: tuple[tuple[int, int], ...]
    request: Request | None
    stopping: bool


class RingletOutcome(NamedTuple):
    """The effects of a ringlet, by numbers.

    It has the same effects for all times in the state above `low_ns`, up to `high_ns`, if the
    machines of `asked` are in these control states, and those of `looked` have these variables.
    If it `resumed` in place, these are times in the state in which it stood.
    """

    low_ns: float
    high_ns: float
    asked: tuple[tuple[int, int], ...]
    looked: tuple[tuple[int, int], ...]
    control: int
    variables: int
    restarted: bool
    """True if its state's clock was started, or will be in its next turn."""
    went_on: bool
    """True if its state's clock is that of before a suspension."""
    resumed: bool
    """True if it went on in place, also if it has left that state since."""
    posts: tuple[tuple[str, int], ...]
    found: tuple[tuple[str, int], ...]
    """What its sensors found of its own posts, by slot: a request's come before the snapshot."""
    others: tuple[tuple[int, int], ...]
    """The machines whose control state it changed, and the new one."""
    inner: tuple[tuple[int, int], ...]
    """The machines whose variables it changed, and the new ones."""
    limits: tuple[tuple[str, int], ...]
    """The times that it compared with the time in a state, with that state, in order."""
    fired: tuple[str, int] | None
    """The state and the number of the transition that fired."""
    error: int
    """The number of the error that its code has raised; 0 if none."""


class ExploredEnvironment(Environment):
    """Answer one ringlet at a time from `contents`, and keep what it asked for and posted.

    `begin` is called before each. `members` and `watchers` are names of machines: all, and the
    monitors, which watch the others.
    """

    def __init__(self) -> None:
        self.members: Set[str] = frozenset()
        self.watchers: Set[str] = frozenset()
        self.learning = False
        """True until it is known what code loads, and so which names are of machines."""
        self.clock = _Clock(self)
        self.contents: dict[str, Any] = {}
        """The message in each slot, by name; None before the first."""
        self.posted: dict[str, Any] = {}
        """The last message that the ringlet posted to each slot, by name."""
        self.found: dict[str, Any] = {}
        """What its sensors found of them."""
        self.outside: Set[str] = frozenset()
        """The names of the machines of other processes that are declared."""
        self.unanswered = ""
        """The name of one that was asked for though no answer was given."""
        self._questions: Counter[str] = Counter()
        self.touched: set[str] = set()
        """The names of the machines whose control state it asked for or changed."""
        self.looked: set[str] = set()
        """The names of the inner machines whose variables it looked at or changed."""
        self.made: set[str] = set()
        """The names of those that it made or ended, so that what they were does not matter."""
        self.ended: set[str] = set()
        """The names of those that it looked at though they had ended."""
        self.limits: dict[tuple[Since, int], None] = {}
        """The times in ns, none below 0, that it compared the time in its state with, in order."""
        self.low_ns: float = -inf
        self.high_ns: float = inf
        """It has the same effects for all times in its state above `low_ns`, up to `high_ns`."""
        self.refusal: UnsupportedError | None = None
        self._noted: tuple[set[str] | dict[Any, Any], ...] = (
            *(self.posted, self.found, self.touched, self.looked, self.made, self.ended),
            *(self.limits, self._questions),
        )
        self._machine = ""
        self._elapsed_ns: int | None = None
        self._stood_ns = 0
        self.entered: Any = _Moment(self, "its entry")
        """The moment at which the machine on turn has entered its state."""
        self.entered_elsewhere: Any = _Moment(self, "its entry", elsewhere=True)
        """The moment at which another machine has."""
        self.stood: Any = _Moment(self, "before the suspension")
        """The moment at which the machine on turn has entered the state in which it stands."""
        self.suspended: Any = _Moment(self, "its entry", elsewhere=True)
        """The moment at which it was suspended there."""

    def begin(self, machine: str, elapsed_ns: int | None, stood_ns: int) -> None:
        """Prepare for a ringlet of `machine`.

        It has been in its state for `elapsed_ns`, None if it is about to enter it; and in that in
        which it stands for `stood_ns`.
        """
        for noted in self._noted:
            if noted:  # few are, and this is done for each ringlet
                noted.clear()
        self.unanswered, self.refusal = "", None
        self.low_ns, self.high_ns = -inf, inf
        self._machine, self._elapsed_ns, self._stood_ns = machine, elapsed_ns, stood_ns

    def refuse(self, what: str, machine: str = "") -> NoReturn:
        """Raise `UnsupportedError` for something that `machine`, or the one on turn, does."""
        if self.refusal is None:
            self.refusal = UnsupportedError(f"{machine or self._machine} {what}")
        raise self.refusal

    def is_longer(self, limit: float, since: Since) -> bool:
        """Compare the time of the machine on turn in its state with `limit` ns: True if longer."""
        stood = since == "before the suspension"
        elapsed_ns = 0 if since == "this turn" else self._stood_ns if stood else self._elapsed_ns
        if elapsed_ns is None:
            self.refuse(
                "asks for the time in OnSuspend or OnResume, before the clock of its state "
                "starts: this cannot be explored; ask in OnEntry or later"
            )
        if not isfinite(limit):
            return limit == -inf
        limit_ns = floor(limit)
        if limit_ns < 0:
            return True
        self.limits[since, limit_ns] = None
        longer = elapsed_ns > limit_ns
        if since == "this turn":  # which is so whatever the time was before
            pass
        elif longer:
            self.low_ns = max(self.low_ns, limit_ns)
        else:
            self.high_ns = min(self.high_ns, limit_ns)
        return longer

    # Reading, posting and asking for machines

    def read(self, machine: str, name: str, sensor: Sensor[Any, Any], slot: Slot[Any]) -> Read:
        """Make a function that looks the slot's message up in `contents`."""
        where = slot.name
        return lambda: self.look(where)

    def look(self, slot: str) -> Any:
        """Return the message in a slot for a sensor."""
        message = self.contents[slot]
        if slot in self.posted:
            self.found[slot] = message
        return message

    def read_aged(
        self,
        machine: str,
        name: str,
        sensor: Sensor[Any, Any],
        slot: Slot[Any],
        start_count: int | None = None,
    ) -> AgedRead:
        """Make a function that looks the message up in `contents`, if it is not too old there."""
        return _Aged(self, machine, name, slot)

    def post(self, machine: str, name: str, actuator: Actuator[Any], slot: Slot[Any]) -> Post:
        """Make a function that checks and keeps a message, and returns an unusable count."""
        from llfsm.whiteboard import Whiteboard

        board, where = Whiteboard.local(), slot.name
        bound = board[slot]  # which checks as every board does
        count: Any = Unknown(self, f"the count that its actuator of {where!r} returned")

        def post(message: Any) -> int:
            bound.add(message)
            # Its own sensors find it, where what a request posts comes before the snapshot.
            self.posted[where] = self.contents[where] = bound.get()
            return count  # type: ignore[no-any-return]

        return post

    def elsewhere(self, name: str, known: Iterable[str]) -> Elsewhere:
        """Answer for a machine of another process; refuse one that is not declared.

        One of those explored that is not there is gone.
        """
        if name in self.outside:
            return self._answer(name, known)
        if name not in self.members and not self.learning:
            self.refuse(
                f"asks for the machine {name!r}, which is not among those explored "
                f"({', '.join(known)}): add it, or declare it (elsewhere) if others run it"
            )
        self.touched.update(self.members)  # of which the error names those that are there
        raise UnknownMachineError(name, known)

    def _answer(self, name: str, known: Iterable[str]) -> Elsewhere:
        if self._machine in self.watchers:
            self.refuse(f"asks for {name}: a monitor knows no machines of other processes")
        self._questions[name] += 1
        if self._questions[name] > _MOST_QUESTIONS:
            self.refuse(f"asks for {name} more than {_MOST_QUESTIONS} times in a turn")
        slot = question_slot(self._machine, name, self._questions[name])
        if slot not in self.contents:
            self.unanswered = name
        answer = self.contents.get(slot)
        if answer is None:
            self.touched.update(self.members)  # of which the error names those that are there
            raise UnknownMachineError(name, known)
        return _Answering(self, name, *answer)

    def requested(self, action: str, machine: str) -> None:
        """Note a machine whose control state is changed; refuse a monitor that acts."""
        if self._machine in self.watchers and machine != self._machine:
            self.refuse(f"asks to {action} {machine}: a monitor must not act")
        self.ask(machine)

    def ask(self, machine: str) -> None:
        """Note that a machine is asked for; a monitor is not there for the others."""
        if machine in self.watchers and self._machine not in self.watchers:
            self.refuse(
                f"reaches the monitor {machine}, as suspend_all and number_of_machines do: without "
                f"it this would do something else; name the machines instead"
            )
        self.touched.add(machine)

    def look_at(self, machine: str, *, ended: bool = False) -> None:
        """Note that the variables of an inner machine are looked at, or may be changed."""
        self.looked.add(machine)
        if ended:
            self.ended.add(machine)

    def make(self, machine: str) -> None:
        """Note that an inner machine gets new variables."""
        if machine not in self.looked:
            self.looked.add(machine)
            self.made.add(machine)


class _Answering:
    """A machine of another process, with a status of those that are declared."""

    def __init__(self, environment: ExploredEnvironment, name: str, state: str, suspended: bool):
        self._environment = environment
        self._name = name
        self.state = state
        self.suspended = suspended

    def request(self, action: Literal["suspend", "resume", "restart"]) -> Status:
        """Return its status; that of a resume is not known, as a restart may be pending."""
        if action == "resume":
            what = f"the status that resume({self._name!r}) returned, which others may restart"
            return cast("Status", Unknown(self._environment, what))
        return Status.SUSPENDED if self.suspended else Status.RUNNING


class _Aged:
    """Read a sensor whose message may be too old; refuse the question how old it is."""

    start_count = 0

    def __init__(self, environment: ExploredEnvironment, machine: str, name: str, slot: Slot[Any]):
        self._environment = environment
        self._machine = machine
        self._name = name
        self._slot = slot.name

    def __call__(self) -> object:
        return self._environment.look(self._slot)

    def age_ns(self) -> NoReturn:
        """Refuse: only whether a message is too old for its sensor is explored."""
        self._environment.refuse(
            f"asks how old the message of its sensor {self._name!r} is (age_ms): this cannot be "
            f"explored; give the sensor a max_age_ms, and test for None",
            self._machine,
        )


class _Clock(Clock):
    """The clock, whose moments are opaque."""

    def __init__(self, environment: ExploredEnvironment):
        self._now: Any = _Moment(environment, "this turn")

    def now_ns(self) -> int:
        """Return this moment."""
        return self._now  # type: ignore[no-any-return]

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return at once: no machine sleeps."""


class _Opaque:
    """A value that refuses every use but those that its class defines."""

    def __init__(self, environment: ExploredEnvironment):
        self._environment = environment


class _Moment(_Opaque):
    """Now, or when the machine on turn, or another one, has entered its state."""

    def __init__(self, environment: ExploredEnvironment, since: Since, *, elsewhere: bool = False):
        super().__init__(environment)
        self.since: Since = since
        self.elsewhere = elsewhere

    def __add__(self, other: object) -> Self:
        """Return this moment for 0, as times in a state are kept."""
        if other != 0:
            self._refuse()
        return self

    def __sub__(self, other: object) -> Any:
        if other is self._environment.suspended:
            return 0  # what it stood there for is no part of the time in a state
        if self.since != "this turn" or not (isinstance(other, _Moment) or other == NEVER):
            self._refuse()
        if isinstance(other, _Moment) and other.elsewhere:
            self._environment.refuse(
                "runs a machine whose OnSuspend asks for the time: this cannot be explored"
            )
        since = other.since if isinstance(other, _Moment) else "its entry"
        return _Elapsed(self._environment, since)

    __eq__, __ne__, __hash__ = object.__eq__, object.__ne__, object.__hash__

    def _refuse(self, *_: object) -> NoReturn:
        self._environment.refuse(
            "uses the time other than to ask whether it has been in its state for longer than "
            "some limit (after, after_ms, timeout): this cannot be explored"
        )


class _Elapsed(_Opaque):
    """The time in the state, which may have been entered in this very ringlet."""

    def __init__(self, environment: ExploredEnvironment, since: Since):
        super().__init__(environment)
        self._since: Since = since

    def __gt__(self, limit: float) -> bool:
        return self._environment.is_longer(limit, self._since)

    def __le__(self, limit: float) -> bool:
        return not self > limit

    def _refuse(self, *_: object) -> NoReturn:
        self._environment.refuse(
            "compares the time in its state other than with > or <=: this cannot be explored"
        )


class Unknown(_Opaque):
    """A result that is not part of a state, such as the count that an actuator returns."""

    def __init__(self, environment: ExploredEnvironment, what: str):
        super().__init__(environment)
        self._what = what

    def _refuse(self, *_: object) -> NoReturn:
        self._environment.refuse(f"uses {self._what}: this cannot be explored")


def _close(cls: type) -> None:
    """Let a class refuse each operator that it does not define."""
    for name in (
        *("bool", "int", "float", "index", "hash", "str", "repr", "format", "iter", "len"),
        *("eq", "ne", "lt", "le", "gt", "ge", "add", "radd", "sub", "rsub", "mul", "rmul"),
        *("truediv", "floordiv", "mod", "divmod", "neg", "abs", "and", "or", "xor", "rtruediv"),
        *("rfloordiv", "rmod", "rand", "ror", "rxor", "round"),
    ):
        method = f"__{name}__"
        if method not in vars(cls):
            setattr(cls, method, cls._refuse)  # type: ignore[attr-defined]


for _each in (_Moment, _Elapsed, Unknown):
    _close(_each)
