"""Unmodelled state: all that code could depend on besides the state of an exploration.

The tables of ringlets are right only if each ringlet does the same whenever it is given the same.
Two checks at the end of an exploration look for code that breaks this:

*Determinism* (`check_determinism`). Ringlets are run again: in another order, with copies of
messages, and with shuffled sets. Code that reads random numbers, globals or the order of a set then
does something else, sooner or later. A clock or a file may not change meanwhile, so this is done
under a profile hook that finds calls that read them. Where each state is a ringlet of its own, that
would take longer than the exploration: of many ringlets, a sample is run again.

*State elsewhere* (`UnmodelledState`). What the code names is compared before and after: globals,
class attributes, variables of functions around it, defaults; and likewise for the functions and
classes that it uses, if they are the user's. Libraries are not looked into: they keep much that
changes nothing, such as caches.
"""

from __future__ import annotations

import gc
import io
import os
import random
import sys
from collections import deque
from collections.abc import Hashable, Iterable, Iterator, Mapping, Set
from functools import partial
from itertools import islice, pairwise, zip_longest
from types import FrameType, FunctionType, MethodType, ModuleType, SimpleNamespace
from typing import Any, Final, NamedTuple, cast

from llfsm import errors
from llfsm.runtime._values import shuffled
from llfsm.runtime.engine.events import Eval, Event, Section
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.ports import Actuator, Sensor
from llfsm.runtime.engine.ringlet import defined_ringlet
from llfsm.runtime.engine.seat import Seat
from llfsm.runtime.engine.state import State
from llfsm.runtime.expressions.purity import reaches_outside, reads_outside
from llfsm.runtime.expressions.reads import names_in
from llfsm.runtime.verification._ringlets import GiveTurns, Ringlets
from llfsm.runtime.verification.environment import Given, RingletOutcome, UnknownControlError
from llfsm.runtime.verification.errors import UnsupportedError, VerificationError

_LLFSM: Final = os.path.dirname(errors.__file__) + os.sep
_MACHINES: Final = os.path.join(_LLFSM, "machines", "")
_PACKAGES: Final = ("site-packages", "dist-packages")
_LIBRARIES: Final = (
    os.path.dirname(os.__file__) + os.sep,
    *(path + os.sep for path in sys.path if os.path.basename(path) in _PACKAGES),
    _LLFSM,
)
_ATOMS: Final = (int, str, bool, bytes, complex, type(None))
_UNSEEN: Final = ("logging", "linecache", "tokenize", "llfsm.whiteboard", "llfsm.runtime")
"""Modules that read a clock or files for reports, which no code of a machine sees."""
_SHUFFLING: Final = shuffled.__module__
_STANDARD: Final = sys.stdlib_module_names
_TRIES = 20
_LEAST = 1_000
"""Ringlets to run again at least: of a few, each is run often, as chance may do the same twice."""


# Determinism


def check_determinism(ringlets: Ringlets, kept: Iterable[tuple[Given, RingletOutcome]]) -> None:
    """Run ringlets again, shuffled; raise `VerificationError` if one does something else.

    Raise `TimeUpError` after the deadline. The messages in slots are equal, but other objects: no
    code may depend on which they are.
    """
    each = list(kept)
    chance = random.Random(0)
    chance.shuffle(each)
    different = []
    for given, before in each:
        after, call = _watched(ringlets, given)
        if call:
            raise VerificationError(
                f"{ringlets.seats[given.place].name}, {call}: only variables, sensors and the time "
                f"in the state, as by after_ms, can be explored"
            )
        if after != before:
            different.append(given)
    again = each * (_LEAST // max(1, len(each)))
    chance.shuffle(again)
    different += islice((given for given, before in again if _again(ringlets, given) != before), 1)
    if different:
        raise VerificationError(
            f"{_place(ringlets, different[0])} did not do the same again in the same situation: "
            f"does it read what machines share, compare messages with `is`, or depend on a set's "
            f"order? Only variables, sensors and the time in the state can be explored"
        )


def _again(
    ringlets: Ringlets, given: Given, turns: GiveTurns | None = None
) -> RingletOutcome | None:
    """Run a ringlet; return None if it asks about a machine about which it did not ask before."""
    try:
        return ringlets.run_ringlet(given, copied=True, turns=turns)
    except UnknownControlError:
        return None


def _place(ringlets: Ringlets, given: Given) -> str:
    """Find machine, state and section of the code that does not do the same again."""
    runs = [_steps(ringlets, given) for _ in range(_TRIES)]
    for first, second in pairwise(runs):
        for one, other in zip_longest(first, second):
            if one != other:
                return f"{ringlets.seats[given.place].name}, {(one or other)[0]},"
    state = ringlets.controls[given.place].values[given.control].current
    return f"{ringlets.seats[given.place].name}, state {state},"


def _watched(ringlets: Ringlets, given: Given) -> tuple[RingletOutcome | None, str]:
    """Run a ringlet as `_again`; find its first call of a clock or the like."""
    calls: list[str] = []

    def watch(frame: FrameType, event: str, function: Any) -> None:
        if event != "c_call" or calls:
            return
        module = str(frame.f_globals.get("__name__"))
        if module.startswith(_UNSEEN):
            return
        if function is hash or function is id:  # a `__hash__` may call them, for sets and dicts
            if frame.f_code.co_name == "__hash__" or module.split(".")[0] in _STANDARD:
                return
        elif not (reads_outside(function) or reaches_outside(function)):
            return
        inner, outer = frame, frame.f_back
        while outer is not None and outer.f_code is not defined_ringlet.__code__:
            if outer.f_globals.get("__name__") == _SHUFFLING:
                return  # a shuffled set, which shuffles
            inner, outer = outer, outer.f_back
        if outer is not None:
            running = outer.f_locals
            state, step = running["seat"].place_of(running["state"], running["code"])
            name = getattr(function, "__qualname__", function)
            where = f"{inner.f_code.co_filename}:{inner.f_lineno}"
            calls.append(f"state {state}, {step}, calls {name} ({where})")

    def turns(seats: Iterable[Seat]) -> bool:
        before, collects = sys.getprofile(), gc.isenabled()
        gc.disable()  # what is called when garbage is collected is not the machine's code
        sys.setprofile(watch)
        try:
            return ringlets.kernel.give_turns(seats)
        finally:
            sys.setprofile(before)
            if collects:
                gc.enable()

    return _again(ringlets, given, turns), calls[0] if calls else ""


def _steps(ringlets: Ringlets, given: Given) -> list[tuple[str, object]]:
    """Run a ringlet; list its sections with the changes by their ends, and guards with results."""
    steps: list[tuple[str, object]] = []
    begun: list[str] = []

    def end_section() -> None:
        if begun:
            steps.append((begun.pop(), ringlets.fingerprint(given.place)))

    def observe(event: Event) -> None:
        if isinstance(event, Section | Eval):
            end_section()
        if isinstance(event, Section):
            begun.append(f"state {event.state}, {event.section}")
        elif isinstance(event, Eval):
            steps.append((f"state {event.state}, transition {event.label}", event.value))

    ringlets.kernel.attach(observe)
    try:
        _again(ringlets, given)
        end_section()
    finally:
        ringlets.kernel.detach(observe)
    return steps


# State elsewhere


class _Place(NamedTuple):
    machine: str
    where: str
    image: Hashable
    held: Any
    """The holder and the value: kept so that no other object gets their ids."""


class UnmodelledState:
    """A picture, taken now, of all that the code of `machines`, by name, could change.

    Raise `UnsupportedError` if it names an iterator, whose place cannot be read.
    """

    def __init__(self, machines: Mapping[str, Machine]):
        self._machines = {name: [type(m), *vars(m).values()] for name, m in machines.items()}
        look = self._look()
        self._before, self._holders = look.found, look.holders

    def check(self) -> None:
        """Raise `UnsupportedError` if anything is not as it was when this was made."""
        after = self._look().found
        for key in {**self._before, **after}:
            was, now = self._before.get(key), after.get(key)
            changed = was and now and was.image != now.image
            if changed or now is None or (was is None and key[0] in self._holders):
                machine, where, *_ = was or after[key]
                raise UnsupportedError(
                    f"{machine} changes {where}: that is not part of a state, so this cannot be "
                    f"explored; keep it in a variable, or make it before the machines run"
                )

    def _look(self) -> _Look:
        files = (_file_of(cls) for cls, *_ in self._machines.values())
        look = _Look({os.path.dirname(file) for file in files if not file.startswith(_LLFSM)})
        for name, (cls, *values) in self._machines.items():
            look.machine = name
            look.follow([cls, *values])
        return look


class _Look:
    """A walk over all that code reaches; modules in `folders` are the user's in any case."""

    def __init__(self, folders: Set[str]):
        self.found: dict[tuple[int, str], _Place] = {}
        """By the id of its holder, and its name there."""
        self.holders: set[int] = set()
        """The ids of all that could have more."""
        self.machine = ""
        self._folders = folders
        self._followed: set[int] = set()

    def follow(self, values: Iterable[Any]) -> None:
        """Note all that the code of functions and classes names, and go on with that."""
        todo = [*values]
        while todo:
            each = todo.pop()
            if id(each) not in self._followed:
                self._followed.add(id(each))
                todo += self._used_by(each)

    def _used_by(self, value: Any) -> Iterator[Any]:
        match value:
            case FunctionType():
                yield getattr(value, "__wrapped__", None)
                if self._is_own(value.__code__.co_filename):
                    yield from self._named_in(value)
            case type():
                machine = issubclass(value, Machine) and value is not Machine
                if machine or self._is_own(_file_of(value)):
                    yield from value.__bases__
                    yield from self._noted(value, vars(value), f"{value.__qualname__}.{{}}")
                    yield from cast("type[Machine]", value).table.states if machine else ()
            case State():
                yield from value.sections.values()
                yield from (each.guard for each in value.transitions)
            case Sensor() | Actuator():
                yield value.slot.type
            case Machine():
                yield type(value)
            case property():
                yield from (value.fget, value.fset, value.fdel)
            case partial():
                yield from (value.func, *value.args, *value.keywords.values())
            case MethodType() | staticmethod() | classmethod():
                yield from (value.__func__, getattr(value, "__self__", None))
            case _:
                yield from (type(value), getattr(value, "__wrapped__", None))
                if isinstance(value, dict | list | tuple | deque | set | frozenset):
                    yield from _parts_of(value) or ()
                elif self._is_own_data(value):
                    yield from _attributes_of(value)

    def _named_in(self, function: FunctionType) -> Iterator[Any]:
        names, scope = names_in(function.__code__), function.__globals__
        modules = [each for name in names if isinstance(each := scope.get(name), ModuleType)]
        for module in (scope, *map(vars, modules)):  # a name after a module's may be one of its own
            if module is scope or self._is_own(module.get("__file__") or ""):
                named = {name: module[name] for name in names & module.keys()}
                yield from self._noted(module, named, f"the global {module.get('__name__')}.{{}}")
        where = function.__qualname__
        code, around = function.__code__, f"{{}}, a variable around {where}"
        for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            yield from self._noted(cell, _content_of(cell, name), around)
        given = function.__defaults__ or ()
        last = code.co_varnames[code.co_argcount - len(given) : code.co_argcount]
        defaults = dict(zip(last, given, strict=True)) | (function.__kwdefaults__ or {})
        yield from self._noted(function, defaults, f"the default of {{}} of {where}")
        yield from self._noted(function, vars(function), f"{where}.{{}}")

    def _noted(self, holder: Any, values: Mapping[str, Any], where: str) -> Iterator[Any]:
        self.holders.add(id(holder))
        for name, value in values.items():
            if name.startswith("_") and name.endswith("_") and not callable(value):
                continue  # of Python itself, which makes members of flags as they are needed
            if self._keeps_its_place(value):
                raise UnsupportedError(
                    f"{self.machine} uses {where.format(name)}, of type {type(value).__name__}: "
                    f"how far it has come is not part of a state, so this cannot be explored; keep "
                    f"a number in a variable"
                )
            image = self._image(value, {})
            place = _Place(self.machine, where.format(name), image, (holder, value))
            self.found.setdefault((id(holder), name), place)
            yield value

    def _keeps_its_place(self, value: Any) -> bool:
        foreign = not isinstance(value, io.IOBase) and not self._is_own(_file_of(type(value)))
        return isinstance(value, Iterator) and foreign

    def _image(self, value: Any, seen: dict[int, int]) -> Hashable:
        """Make a key that is equal as long as the value is the same; `seen` numbers its parts."""
        kind = type(value)
        if kind in _ATOMS:
            return kind, value
        if kind is float:
            return kind, value.hex()
        if id(value) in seen:
            return "again", seen[id(value)]
        parts = _parts_of(value)
        own = _attributes_of(value) if kind is SimpleNamespace or self._is_own_data(value) else None
        if parts is None and own is None:
            return kind, id(value)
        seen[id(value)] = len(seen)
        images = [self._image(part, seen) for part in (*(parts or ()), *(own or ()))]
        return kind, frozenset(images) if isinstance(value, set | frozenset) else tuple(images)

    def _is_own_data(self, value: Any) -> bool:
        code = isinstance(value, type | FunctionType | MethodType | ModuleType)
        return not code and self._is_own(_file_of(type(value)))

    def _is_own(self, file: str) -> bool:
        library = file.startswith(_LIBRARIES) and not file.startswith(_MACHINES)
        return not library or os.path.dirname(file) in self._folders


def _content_of(cell: Any, name: str) -> dict[str, Any]:
    try:
        return {name: cell.cell_contents}
    except ValueError:
        return {}  # it has none yet


def _file_of(cls: type) -> str:
    """Find the file that defines a class; a file of Python itself for one in C."""
    module = sys.modules.get(cls.__module__)
    if module is None or cls.__module__ == "__main__":
        return getattr(module, "__file__", None) or ""
    return getattr(module, "__file__", None) or _LIBRARIES[0]


def _parts_of(value: Any) -> Iterable[Any] | None:
    """List the parts of a container or buffer; None for any other value."""
    if isinstance(value, dict):
        return (part for item in value.items() for part in item)
    if isinstance(value, list | tuple | deque | set | frozenset):
        return value
    try:
        return (memoryview(value).tobytes(),)
    except (TypeError, ValueError):
        return None


def _attributes_of(value: Any) -> list[Any]:
    names = [*getattr(value, "__dict__", ()), *getattr(value, "__struct_fields__", ())]
    for cls in type(value).__mro__:
        slots = vars(cls).get("__slots__", ())
        names += (slots,) if isinstance(slots, str) else slots
    return [part for name in dict.fromkeys(names) for part in (name, getattr(value, name, None))]
