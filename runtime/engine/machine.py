"""A machine: a class with states, and what its code may ask of time and of other machines."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from types import new_class
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar, Unpack, cast, dataclass_transform

from llfsm.errors import did_you_mean
from llfsm.runtime.engine.errors import DefinitionError, NotLoadedError, VariableError
from llfsm.runtime.engine.events import Call, Status
from llfsm.runtime.engine.state import ClassBody, State
from llfsm.runtime.engine.submachine import Submachine
from llfsm.runtime.engine.table import REQUIRED, Table, make_table

if TYPE_CHECKING:
    from llfsm.runtime.engine.kernel import Loadable, LoadOptions
    from llfsm.runtime.engine.seat import Seat


R = TypeVar("R")
M = TypeVar("M", bound="Machine")


@dataclass_transform(kw_only_default=True)
class MachineType(type):
    """The class of machine classes: it makes and checks the table when a class is made."""

    table: Table

    @classmethod
    def __prepare__(cls, name: str, bases: tuple[type, ...], /, **_: Any) -> ClassBody:
        """Return the namespace of the class body, which knows the parent's states."""
        parents = [base for base in bases if hasattr(base, "table")]
        if len(parents) > 1:
            raise DefinitionError(
                f"{name}: a machine extends one machine; share ports, variables and methods "
                f"through classes that are not machines"
            )
        if not parents:
            return ClassBody(name, None, ())
        return ClassBody(name, parents[0], parents[0].table.states)

    def __new__(
        mcs,
        name: str,
        bases: tuple[type, ...],
        namespace: ClassBody,
        *,
        path: str | None = None,
        states: Iterable[State] | None = None,
    ) -> MachineType:
        """Make the class; `path` and `states` replace its own name and the states of its body."""
        if not bases:
            return super().__new__(mcs, name, bases, dict(namespace))
        if not isinstance(namespace, ClassBody):
            raise DefinitionError(f"{name}: make machines with a class statement or define()")
        if states is None:
            states = _named_states(name, namespace)
        left = {"_", *namespace.loops}
        attributes = {key: value for key, value in namespace.items() if key not in left}
        for base in bases:
            for key, value in vars(base).items():
                if isinstance(value, State) and value.name in namespace.inherited:
                    attributes.setdefault(key, namespace.inherited[value.name])
        cls = super().__new__(mcs, name, bases, attributes)
        path = path or f"{cls.__module__}:{cls.__qualname__}"
        cls.table = make_table(cls, namespace, path, states, Machine)
        return cls

    def __init__(cls, name: str, bases: tuple[type, ...], namespace: ClassBody, **_: Any):
        super().__init__(name, bases, namespace)


def _named_states(owner: str, body: ClassBody) -> list[State]:
    named: list[State] = []
    for name, value in body.items():
        if name in body.loops:
            continue
        if value is State:
            raise DefinitionError(f"{owner}: {name!r} is the class State; write {name} = State()")
        if isinstance(value, State) and value.owner is None:
            if value in named:
                raise DefinitionError(
                    f"{owner}: the state {value.name!r} is also called {name!r}; give it one name"
                )
            value.name = value.name or name
            named.append(value)
    return named


class Machine(metaclass=MachineType):
    """Subclass this to declare a machine; see `State`, `Sensor` and `Actuator`.

    Annotated attributes are the machine's variables: every instance has its own, starting with
    a copy of the default, and `Wanderer(turns=3)` gives another value. An unknown name, a
    missing value or a wrong type raises `VariableError`.
    """

    __slots__ = ("_seat",)

    def __init__(self, **variables: Any):
        cls = type(self)
        if cls is Machine:
            raise DefinitionError("Machine has no states: make a subclass")
        self._seat: Seat = cast("Seat", _NoSeat(cls.__name__))
        unknown = variables.keys() - cls.table.variables.keys()
        if unknown:
            name, known = min(unknown), cls.table.variables
            raise VariableError(
                f"{cls.__qualname__} has no variable {name!r}; it has: "
                f"{', '.join(known) or 'none'}{did_you_mean(name, known)}"
            )
        for name, variable in cls.table.variables.items():
            if name in variables:
                setattr(self, name, variable.check(variables[name]))
            elif variable.default is REQUIRED:
                raise VariableError(f"{cls.__qualname__} needs a value for its variable {name!r}")
            else:
                setattr(self, name, variable.initial())

    # Time since the state was entered

    def after_ms(self, ms: float) -> bool:
        """Return True if more than `ms` milliseconds have passed since the state was entered."""
        seat = self._seat
        return seat.now() - seat.entered_ns > ms * 1_000_000

    def after(self, s: float) -> bool:
        """Return True if more than `s` seconds have passed since the state was entered."""
        seat = self._seat
        return seat.now() - seat.entered_ns > s * 1_000_000_000

    def timeout(self, us: float) -> bool:
        """Return True if more than `us` microseconds have passed since the state was entered."""
        seat = self._seat
        return seat.now() - seat.entered_ns > us * 1_000

    # The age of what was sensed

    def age_ms(self, sensor: str) -> float | None:
        """Return the age of a sensor's message in the snapshot, in milliseconds.

        None if there is none. `sensor` is the sensor's name in the class. Messages from another
        host are as old as the time since they came to this one. Raise `SensorNameError`.
        """
        age_ns = self._seat.age_ns(sensor)
        return None if age_ns is None else age_ns / 1e6

    # This machine and its arrangement

    @property
    def name(self) -> str:
        """The name under which it was loaded; before that, its class's."""
        return self._seat.name

    @property
    def state_name(self) -> str:
        """The name of the current state; during an OnExit it is already the target."""
        return self._seat.current.name

    @cached_property  # an attribute of its own from its loading on: guards of all states read it
    def stopping(self) -> bool:
        """True if it or all machines were asked to stop: make for an accepting state."""
        return self._seat.stopping

    @property
    def failure(self) -> Any:  # so that a machine may have one of its own, of another type
        """The `ExecutionError` for which this machine was suspended; None if there was none."""
        failure = self._seat.failure
        return None if failure is None else failure.error

    @property
    def number_of_machines(self) -> int:
        """The number of indices in use, holes included."""
        return self._called("number_of_machines", None, self._seat.control.number_of_machines)

    # Requests. All take effect at the machine's next turn and return its status before. They
    # and the questions below also reach machines that other processes run on the whiteboard; a
    # unknown name raises `UnknownMachineError`.

    def suspend(self, name: str) -> Status:
        """Suspend machine `name`: it enters its suspend state and remembers where it was."""
        return self._called("suspend", name, self._seat.control.suspend(name))

    def resume(self, name: str) -> Status:
        """Return a suspended machine to where it was; `Status.ERROR` if a restart is pending."""
        return self._called("resume", name, self._seat.control.resume(name))

    def restart(self, name: str) -> Status:
        """Start machine `name` again from its initial state, suspended or not."""
        return self._called("restart", name, self._seat.control.restart(name))

    def suspend_self(self) -> Status:
        """Suspend this machine at its next turn."""
        return self._called("suspend_self", None, self._seat.control.suspend(self.name))

    def resume_self(self) -> Status:
        """Resume this machine at its next turn, from its suspend state's own code."""
        return self._called("resume_self", None, self._seat.control.resume(self.name))

    def restart_self(self) -> Status:
        """Restart this machine at its next turn."""
        return self._called("restart_self", None, self._seat.control.restart(self.name))

    def suspend_all(self) -> None:
        """Suspend every machine but this one."""
        self._seat.control.suspend_all(self._seat)
        self._called("suspend_all", None, None)

    def abandon(self, name: str) -> bool:
        """Suspend machine `name` at once: its suspended ringlet runs inside this call."""
        return self._called("abandon", name, self._seat.control.abandon(name, self._seat))

    # Questions

    def status(self, name: str) -> Status:
        """Return `Status.RUNNING` or `Status.SUSPENDED`; a request alone changes neither."""
        return self._called("status", name, self._seat.control.status(name))

    def is_suspended(self, name: str) -> bool:
        """Return True if machine `name` is in its suspend state."""
        return self._called("is_suspended", name, self._seat.control.is_suspended(name))

    def is_running(self, name: str) -> bool:
        """Return True if machine `name` is not suspended."""
        return self._called("is_running", name, self._seat.control.is_running(name))

    def index_of(self, name: str) -> int:
        """Return the place of machine `name` in the order, from 0."""
        return self._called("index_of", name, self._seat.control.index_of(name))

    def name_of(self, index: int) -> str:
        """Return the name of the machine at `index`."""
        return self._called("name_of", index, self._seat.control.name_of(index))

    def state_name_of(self, name: str) -> str:
        """Return the name of the current state of machine `name`."""
        return self._called("state_name_of", name, self._seat.control.state_name_of(name))

    # Loading

    def load(self, machine: Loadable, **how: Unpack[LoadOptions]) -> int:
        """Load a machine and return its index: its first turn is in this round if still ahead.

        `name`, `variables` and `slots` are as for `Arrangement.load`.
        """
        return self._called("load", _called_by(machine), self._seat.control.load(machine, **how))

    def load_suspended(self, machine: Loadable, **how: Unpack[LoadOptions]) -> int:
        """Load a machine that begins in its suspend state, and return its index."""
        index = self._seat.control.load_suspended(machine, **how)
        return self._called("load_suspended", _called_by(machine), index)

    def call_machine(
        self, machine: type[M] | M | str, *, detached: bool = False, **how: Unpack[LoadOptions]
    ) -> Submachine[M]:
        """Load a machine as a submachine, whose end can be waited for and its results read.

        Keep what is returned in a variable, guard a transition with its `done`, and read the
        variables of its `machine`. The call belongs to the state in which it is made: when that is
        left, or this machine is suspended, restarted, unloaded or fails, the submachine is
        unloaded and posts its safe values first. One that is `detached` stays loaded.
        """
        control = self._seat.control
        called = control.call_machine(machine, self._seat, detached=detached, **how)
        return self._called("call_machine", _called_by(machine), called)

    def unload(self, name: str) -> bool:
        """Unload machine `name` and return True; this machine goes at the end of its ringlet."""
        return self._called("unload", name, self._seat.control.unload(name, self._seat))

    def _called(self, operation: str, argument: str | int | None, result: R) -> R:
        """Report a call to the observers, if a section makes it, and return its result."""
        seat = self._seat
        if seat.doing is not None:
            kernel = seat.kernel
            call = Call(*kernel.stamp(), seat.name, seat.doing, operation, argument, result)
            kernel.emit(call)
        return result


class _NoSeat:
    """Stand in for the seat of a machine that is not loaded: every use of it raises."""

    taken = False

    def __init__(self, name: str):
        self.name = name

    def __getattr__(self, _: str) -> NoReturn:
        raise NotLoadedError(f"{self.name} is in no arrangement: load it first")


def define(
    name: str,
    states: Iterable[State],
    *,
    variables: Mapping[str, tuple[Any, Any]] | None = None,
    attributes: Mapping[str, Any] | None = None,
    path: str | None = None,
) -> type[Machine]:
    """Make a machine class from states instead of a class body, as bundles and tests do.

    The states need names, and become no attributes of the class. `variables` maps names to
    (type, default), `attributes` holds sensors, actuators and methods; `path` identifies the
    machine when a hole is looked for.
    """
    variables = variables or {}

    def fill(body: dict[str, Any]) -> None:
        body.update(attributes or {})
        body["__annotations__"] = {key: kind for key, (kind, _) in variables.items()}
        body.update((key, value) for key, (_, value) in variables.items() if value is not REQUIRED)

    return new_class(name, (Machine,), {"states": tuple(states), "path": path or name}, fill)


def _called_by(machine: Loadable) -> str:
    if isinstance(machine, str):
        return machine
    return machine.__name__ if isinstance(machine, type) else type(machine).__name__
