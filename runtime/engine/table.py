"""The table of a machine class: its states in order, variables and ports, checked once.

The runner, the drawing and the checker read it, and nothing changes it after the class is made. It
may have a layout, where an editor has drawn the machine: that is a hint, which may lack states and
transitions, and running a machine never reads it.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from itertools import count, islice
from types import FunctionType, MappingProxyType
from typing import (
    Any,
    ClassVar,
    Final,
    ForwardRef,
    NamedTuple,
    TypeAlias,
    TypeVar,
    cast,
    get_origin,
)

from llfsm.runtime.engine.errors import DefinitionError, UnreachableStateWarning, VariableError
from llfsm.runtime.engine.ports import Actuator, Sensor
from llfsm.runtime.engine.state import ClassBody, Runs, State

Point: TypeAlias = tuple[float, float]
MAY_BE_OWN: Final = frozenset({"failure"})
"""Members of every machine that one may replace by a state or variable of its own."""


class StateBox(NamedTuple):
    """The box of a state: its centre, its size, and whether its sections are shown.

    Coordinates are the editor's points, x to the right and y downwards. `more` is what else an
    editor keeps of it, as colours and the heights of sections, by the names in its property list:
    kept, and never looked at.
    """

    x: float
    y: float
    w: float
    h: float
    expanded: bool = False
    more: Mapping[str, Any] = MappingProxyType({})


class TransitionPath(NamedTuple):
    """The arrow of a transition: a cubic Bézier curve."""

    src: Point
    dst: Point
    control1: Point
    control2: Point


class MachineLayout(NamedTuple):
    """The boxes of states by name, and the paths of each state's transitions, in their order."""

    states: Mapping[str, StateBox] = MappingProxyType({})
    transitions: Mapping[str, tuple[TransitionPath, ...]] = MappingProxyType({})


REQUIRED: Final = type("Required", (), {"__repr__": lambda _: "REQUIRED"})()
"""The default of a variable that has none."""

T = TypeVar("T")

_SHARED = (list, dict, set, bytearray)
_DECLARED = (State, Sensor, Actuator)


class Described(NamedTuple):
    """A variable's default with what `variable` says of it."""

    default: Any
    kept: bool


def variable(default: T, *, kept: bool = True) -> T:
    """Declare a variable's default in a class or bundle, and whether it is `kept` in a file.

    As in ``cache: dict[str, int] = variable({}, kept=False)``: after a restart of the process it
    has its default again, and its values need not be ones that a file can hold.
    """
    described: Any = Described(default, kept)
    return cast("T", described)


class Variable(NamedTuple):
    """A machine variable; `default` is `REQUIRED` if it must be given when the machine is made."""

    name: str
    owner: type
    annotation: Any
    default: Any
    kept: bool = True
    """True if a file of kept machines has it."""

    def initial(self) -> Any:
        """Return the value for a new machine: a copy, so that machines share nothing."""
        return deepcopy(self.default)

    def check(self, value: Any) -> Any:
        """Return `value` if it is of the annotated type, else raise `VariableError`."""
        import msgspec  # here, because most machines are made without values

        try:
            return msgspec.convert(value, self.type)
        except msgspec.ValidationError as error:
            raise VariableError(
                f"{self.owner.__qualname__}: {self.name} = {value!r}: {error}"
            ) from None
        except TypeError:
            return value  # a type of which msgspec knows no values

    @property
    def type(self) -> Any:
        """The annotated type; Any if it names what only type checkers import."""
        # by now, later classes exist
        text = _annotations(self.owner).get(self.name, self.annotation)
        if isinstance(text, ForwardRef):
            text = text.__forward_arg__
        if not isinstance(text, str):
            return text
        module = vars(sys.modules[self.owner.__module__])
        try:
            return eval(text, module, dict(vars(self.owner)))
        except (NameError, AttributeError):
            return Any

    @property
    def type_text(self) -> str:
        """The annotation as it stands in the class."""
        if sys.version_info >= (3, 14):
            import annotationlib

            texts = annotationlib.get_annotations(self.owner, format=annotationlib.Format.STRING)
            return texts[self.name]
        kind = self.annotation
        if isinstance(kind, str):
            return kind
        return kind.__name__ if isinstance(kind, type) else repr(kind)


class Table:
    """All that the runner, the drawing and the checker need of a machine class.

    `suspend` is the declared suspend state, or a state named `Suspend` that has no transition
    in or out, or None. `path` distinguishes machines of the same name. `layout` is the layout
    that an editor has saved, if the machine comes from a bundle with one.
    """

    def __init__(
        self,
        path: str,
        states: tuple[State, ...],
        variables: dict[str, Variable],
        sensors: dict[str, Sensor[Any, Any]],
        actuators: dict[str, Actuator[Any]],
    ):
        self.path = path
        self.states = states
        self.initial = states[0]
        self.suspend = _suspend_state(states)
        self.variables = variables
        self.sensors = sensors
        self.actuators = actuators
        self.layout: MachineLayout | None = None

    @property
    def slots_within(self) -> list[str] | None:
        """The names of the slots that it and what its states run use; None if nobody knows."""
        names, seen, todo = dict[str, None](), set[int](), [self]
        while todo:
            table = todo.pop()
            if id(table) in seen:
                continue
            seen.add(id(table))
            names |= dict.fromkeys(table.slots)
            for runs in [each for state in table.states for each in state.runs]:
                inner = run_by(runs)
                if not inner:
                    return None
                todo += [each.table for each in inner]
        return [*names]

    def inner_name(self, state: State, number: int, name: str) -> str:
        """Return the name of the machine `name` that a state runs, without that of the outer one.

        It is the same in all runs. One that is declared after others of its name has a number.
        """
        before = 0
        for each in self.states:
            for place, runs in enumerate(each.runs):
                if each.name == state.name and place == number:
                    return next(islice(numbered_names(name), before, None))
                before += any(cls.__name__ == name for cls in run_by(runs))
        return name

    @property
    def slots(self) -> list[str]:
        """The names of the slots that the machine uses, each once."""
        names = [port.slot.name for port in self.sensors.values()]
        names += [port.slot.name for port in self.actuators.values()]
        return list(dict.fromkeys(names))

    def _repr_html_(self) -> str:
        """Return the transitions in the order in which they are looked at, for a notebook."""
        from llfsm.whiteboard.message_text import html_table  # here, as few tables are in one

        rows = [
            (state.name, each.label, each.target.name)
            for state in self.states
            for each in state.transitions
        ]
        return html_table(("state", "transition", "to"), rows)


def make_table(cls: type, body: ClassBody, path: str, states: Iterable[State], root: type) -> Table:
    """Check the states and names of `cls`, a subclass of `root`, and put them in order.

    Raise `DefinitionError` if they contradict each other or hide what `root` has.
    """
    owners = [owner for owner in reversed(cls.__mro__) if owner not in root.__mro__]
    reserved = {name for name in dir(root) if name[:2] != "__"} | _annotations(type(root)).keys()
    reserved -= MAY_BE_OWN
    for owner in owners:
        if owner is not cls and isinstance(owner, type(root)):
            continue  # checked when it was made
        for name in {**vars(owner), **_annotations(owner)}:
            if name in reserved:
                raise DefinitionError(
                    f"{owner.__qualname__}: {name!r} would hide what every machine has; rename it"
                )
    table = Table(
        path,
        _complete_states(cls, body, states),
        {variable.name: variable for variable in _variables(cls, owners)},
        _ports(cls, owners, Sensor),
        _ports(cls, owners, Actuator),
    )
    for state in table.states:
        state.owner = cls
    _warn_of_unreachable(cls, table)
    return table


def numbered_names(name: str) -> Iterator[str]:
    """Yield the names for machines called `name`, as `P`, `P.0`, `P.1` … for `P`."""
    yield name
    yield from (f"{name}.{number}" for number in count())


def run_by(runs: Runs) -> list[Any]:
    """List the machine classes that a state may run: of a function, those that its code names."""
    if isinstance(runs, str):
        return []
    if isinstance(runs, type):
        return [runs]
    code = getattr(runs, "__code__", None)
    if code is None:
        return []
    around = dict(zip(code.co_freevars, getattr(runs, "__closure__", None) or (), strict=True))
    cells = {name: cell.cell_contents for name, cell in around.items() if _is_filled(cell)}
    scope = {**getattr(runs, "__globals__", {}), **cells}
    named = (scope.get(name) for name in (*code.co_names, *code.co_freevars))
    return [each for each in named if isinstance(each, type) and hasattr(each, "table")]


def with_inner(cls: Any) -> dict[str, Any]:
    """Map paths to a machine class and all that its states may run, as far as that is known."""
    found: dict[str, Any] = {}
    todo = [cls]
    while todo:
        each = todo.pop()
        if each.table.path not in found:
            found[each.table.path] = each
            todo += [inner for s in each.table.states for runs in s.runs for inner in run_by(runs)]
    return found


class DrawnRuns(str):
    """The names of what a state runs, and its tables, of a machine that is drawn and not run.

    With each table is the name of its machine without that of the outer one.
    """

    tables: tuple[tuple[str, Table], ...] = ()


def run_names(state: State) -> list[str]:
    """List what a state runs, as text: names of machine classes, as far as they are known."""
    return [
        str(runs)
        if isinstance(runs, str)
        else " or ".join(cls.__name__ for cls in run_by(runs)) or "a machine"
        for runs in state.runs
    ]


def _is_filled(cell: Any) -> bool:
    try:
        cell.cell_contents  # noqa: B018  # raises if it has none
    except ValueError:
        return False
    return True


def _annotations(owner: type) -> dict[str, Any]:
    """Return the annotations of `owner` itself; names that are not defined yet do no harm."""
    if sys.version_info >= (3, 14):  # annotations are evaluated when they are asked for
        import annotationlib

        return annotationlib.get_annotations(owner, format=annotationlib.Format.FORWARDREF)
    annotations: dict[str, Any] = vars(owner).get("__annotations__", {})
    return annotations


def _complete_states(cls: type, body: ClassBody, declared: Iterable[State]) -> tuple[State, ...]:
    states = dict(body.inherited)
    own = set()
    for state in declared:
        if not state.name or state.name in own:
            what = f"two states are called {state.name!r}" if state.name else "a state has no name"
            raise DefinitionError(f"{cls.__qualname__}: {what}")
        if state.owner is not None:
            raise DefinitionError(
                f"{cls.__qualname__}: state {state.name!r} belongs to {state.owner.__qualname__}"
            )
        own.add(state.name)
        states[state.name] = state
    if not states:
        raise DefinitionError(f"{cls.__qualname__} declares no states")
    for state in states.values():
        _use_overrides(cls, state)
        leads = [(each.target.name, each.unconditional) for each in state.transitions]
        for _, what in dead_transitions(state.name, leads):
            raise DefinitionError(f"{cls.__qualname__}, {what}")
        for transition in state.transitions:
            target = transition.target
            home = states.get(target.name)
            ours = target is home or target is body.inherited.get(target.name)
            if home is None or not (ours or (target.owner and issubclass(cls, target.owner))):
                whose = (
                    f"belongs to {target.owner.__qualname__}" if target.owner else "is not its own"
                )
                raise DefinitionError(
                    f"{cls.__qualname__}, state {state.name!r}: transition {transition.label!r} "
                    f"leads to a state {target.name!r} that {whose}"
                )
            transition.target = home
    return tuple(states.values())


def _use_overrides(cls: type, state: State) -> None:
    """Let a method of `cls` take the place of the inherited guard or section it is named after."""
    for section, code in state.sections.items():
        state.sections[section] = _override(cls, code)
    for transition in state.transitions:
        if transition.guard is not None:
            transition.guard = _override(cls, transition.guard)


def _override(cls: type, code: Any) -> Any:
    name = getattr(code, "__name__", "")
    inherited = any(vars(base).get(name) is code for base in cls.__mro__)
    mine = getattr(cls, name, None) if inherited else None
    return mine if isinstance(mine, FunctionType) else code


def _variables(cls: type, owners: list[type]) -> Iterator[Variable]:
    for owner in owners:
        annotations = _annotations(owner)
        for name, annotation in annotations.items():
            default = getattr(cls, name, REQUIRED)
            if not _is_constant(annotation) and not isinstance(default, _DECLARED):
                declared = [vars(base).get(name) for base in cls.__mro__]
                kept = all(each.kept for each in declared if isinstance(each, Described))
                plain = default.default if isinstance(default, Described) else default
                yield Variable(name, owner, annotation, plain, kept)
        for name, value in vars(owner).items():
            if isinstance(value, _SHARED) and name not in annotations and name[:2] != "__":
                raise DefinitionError(
                    f"{owner.__qualname__}: machines would share {name!r}; annotate it to make "
                    f"it a variable of each, as in {name}: {type(value).__name__}[...] = {value!r}"
                )


def _is_constant(annotation: Any) -> bool:
    if isinstance(annotation, str):
        return annotation.partition("[")[0].rpartition(".")[2] in ("ClassVar", "Final")
    return annotation in (ClassVar, Final) or get_origin(annotation) in (ClassVar, Final)


def _ports(cls: type, owners: list[type], kind: type[Any]) -> dict[str, Any]:
    names = dict.fromkeys(name for owner in owners for name in vars(owner))
    found = ((name, getattr(cls, name, None)) for name in names)
    return {name: port for name, port in found if isinstance(port, kind)}


def _suspend_state(states: tuple[State, ...]) -> State | None:
    declared = [state for state in states if state.suspend]
    if len(declared) > 1:
        names = " and ".join(repr(state.name) for state in declared)
        raise DefinitionError(f"{names} are both declared as the suspend state")
    if declared:
        return declared[0]
    targets = {transition.target for state in states for transition in state.transitions}
    for state in states:  # as clfsm does, for this name only
        if state.name == "Suspend" and not state.transitions and state not in targets:
            return state
    return None


def _warn_of_unreachable(cls: type, table: Table) -> None:
    roots = [state.name for state in (table.initial, table.suspend) if state is not None]
    targets = {state.name: [t.target.name for t in state.transitions] for state in table.states}
    for _, what in unreachable_states(roots, targets):
        warnings.warn(f"{cls.__qualname__}: {what}", UnreachableStateWarning, stacklevel=4)


def dead_transitions(state: str, leads: Iterable[tuple[str, bool]]) -> Iterator[tuple[int, str]]:
    """Yield the number of each transition of `state` that can never fire, and why.

    `leads` gives each transition's target, and whether it fires whenever it is evaluated.
    """
    first = None
    for number, (target, always) in enumerate(leads):
        if first is not None:
            what = f"the transition to {target!r} can never fire, the one to {first!r} before it"
            yield number, f"state {state!r}: {what} always does"
        elif always:
            first = target


def unreachable_states(
    roots: Iterable[str], targets: Mapping[str, Iterable[str]]
) -> Iterator[tuple[str, str]]:
    """Yield each state that cannot be reached from `roots`, and a sentence about it.

    `targets` gives the states that each state's transitions lead to.
    """
    frontier = list(roots)
    reached = set(frontier)
    while frontier:
        new = set(targets.get(frontier.pop(), ())) - reached
        reached |= new
        frontier += new
    for state in targets:
        if state not in reached:
            yield state, f"no transitions lead to state {state!r}"
