"""Plans: which machines to run and how, from a command line, an arrangement file or dispatch table.

An *arrangement file* is TOML; its keys are the fields of `Plan`, in each `[[machine]]` those of
`PlannedMachine`, and in `[verify]` those of `Verification`. msgspec checks it, and errors name the
line: the parser is asked for the shortest document that has the wrong value (`line_of`).

A *dispatch table*, as for clfsm's ``-T``, has two parts, separated by a blank line. The first has a
line for each machine: its bundle, its period and its deadline in microseconds and, if it is loaded
suspended or only preloaded, an `S` or a `P`. The second has a line for each slot: the number of the
machine, from 0, and the start of the slot in microseconds from the beginning of the cycle. Tabs
separate the fields. clfsm begins the next cycle when the last slot of a cycle starts; here a cycle
is a multiple of all periods, as the tables intend.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from math import lcm
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import msgspec

from llfsm.errors import did_you_mean, nearby_file
from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.errors import ConfigurationError, ScheduleError
from llfsm.runtime.engine.kernel import OnError
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.schedule import Requirement, TimeSlot, Timetable
from llfsm.runtime.engine.table import numbered_names
from llfsm.runtime.log import logger

if TYPE_CHECKING:
    from llfsm.runtime.engine.environment import Environment
    from llfsm.runtime.engine.kernel import Library


T = TypeVar("T")
Path_ = tuple[str | int, ...]
"""The keys and indices that lead to a value of a TOML file."""


_WHERE = re.compile(r" - at (?:key in )?`(\$.*)`$")
_STEP = re.compile(r"\[(\d+|\.\.\.)\]|\.?([^.\[\]]+)")
_NUMBER = re.compile(r"[0-9]{1,12}")  # of a dispatch table: up to a million seconds
_LONGEST_US = 10**12  # eleven days
Positive = Annotated[int, msgspec.Meta(ge=1, le=_LONGEST_US)]
NotNegative = Annotated[int, msgspec.Meta(ge=0, le=_LONGEST_US)]


class PlannedMachine(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One machine; `definition` is its name on the command line.

    `variables` and `slots` are as for `Arrangement.load`. A machine may be loaded `suspended`, or
    only preloaded, for other machines to load. With `period_us` it has a turn at each of
    `start_us` (0) after the beginning of every period, with a deadline `deadline_us` (the period)
    later.
    """

    definition: str
    name: str | None = None
    suspended: bool = False
    preload: bool = False
    variables: dict[str, Any] = {}
    slots: dict[str, str] = {}
    period_us: Positive | None = None
    deadline_us: Positive | None = None
    start_us: NotNegative | tuple[NotNegative, ...] = 0

    def requirement(self, name: str) -> list[Requirement]:
        """Make its requirement of a timetable, under `name`; none without a period."""
        if self.period_us is None:
            return []
        starts = (self.start_us,) if isinstance(self.start_us, int) else self.start_us
        deadline_us = self.period_us if self.deadline_us is None else self.deadline_us
        return [Requirement(name, self.period_us, deadline_us, starts)]


class Verification(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The verification of the machines, as for `llfsm.runtime.verification.explore`.

    Properties and abstractions are named ``module:name``. `period_ms` is by default that of the
    rounds of a run. A domain is "every", a list of messages, a table of fields, each with "every"
    or a list of values, or ``module:name``. `elsewhere` has machines of other processes: a class as
    ``module:name``, or states, with "none" for one that is not there.
    """

    properties: tuple[str, ...] = ()
    sensors: dict[str, str | list[Any] | dict[str, Any]] = {}
    period_ms: Annotated[float, msgspec.Meta(gt=0, le=_LONGEST_US / 1e3)] | None = None
    any_time: bool = False
    skips: bool = False
    choices: Literal["turns", "rounds"] = "turns"
    stop: bool = False
    suspend: tuple[str, ...] = ()
    elsewhere: dict[str, str | tuple[str, ...]] = {}
    abstract: dict[str, str] = {}
    max_states: Positive | None = None
    max_seconds: Annotated[float, msgspec.Meta(ge=0)] | None = None


class Plan(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Machines in their order, and the schedule of their turns, as for `Arrangement`.

    `will_after_ms` is as for `LiveEnvironment`, `on_pause` and `break` as for `Debugger`; with
    `debug_clock` the clock is a `DebugClock`. `verify` has no effect on a run.
    """

    machines: tuple[PlannedMachine, ...] = msgspec.field(name="machine", default=())
    board: str | None = None
    idle_us: NotNegative = 10_000
    wake: bool = True
    period_us: Positive | None = None
    unload_accepting: bool = True
    on_error: OnError = "stop"
    watchdog_ms: Positive | None = None
    realtime: Annotated[int, msgspec.Meta(ge=1, le=99)] | None = None
    cpu: NotNegative | None = None
    grace_s: Annotated[float, msgspec.Meta(ge=0, le=_LONGEST_US / 1e6)] = 1.0
    will_after_ms: Annotated[int, msgspec.Meta(ge=500, le=_LONGEST_US)] | None = None
    on_pause: Literal["keep", "safe"] = "keep"
    debug_clock: bool = False
    breakpoints: tuple[str, ...] = msgspec.field(name="break", default=())
    verify: Verification | None = None

    def timetable(self, names: Iterable[str]) -> Timetable | None:
        """Make the timetable for machines of these names; None if none has a period.

        Raise `ScheduleError` if there is no timetable that meets all periods.
        """
        planned = zip(names, self.machines, strict=True)
        needs = [need for name, machine in planned for need in machine.requirement(name)]
        return Timetable.meeting(needs) if needs else None


def read_plan(file: Path) -> Plan:
    """Read an arrangement file; raise `ConfigurationError` with the line of what is wrong."""
    return read_toml(file, Plan, _check_plan)


def names_of(plan: Plan, classes: Iterable[str]) -> list[str]:
    """List the names that machines of the plan get: a second `P` becomes `P.0`.

    `classes` are the names of their classes. Machines that are only preloaded get their names last.
    """
    names: dict[int, str] = {}
    given = list(enumerate(zip(plan.machines, classes, strict=True)))
    for number, (planned, cls) in sorted(given, key=lambda each: each[1][0].preload):
        candidates = numbered_names(planned.name or cls)
        names[number] = next(free for free in candidates if free not in names.values())
    return [names[number] for number in range(len(names))]


def assemble(
    plan: Plan,
    classes: Mapping[str, type[Machine]],
    environment: Environment,
    *,
    library: Library,
    timed: bool = False,
) -> Arrangement:
    """Make the arrangement of a plan and load its machines; `classes` are by name, in order.

    Suspended machines come after the others, unless a timetable gives each its turns.
    Raise `LoadError` for a machine that cannot be loaded as planned, `ScheduleError` for turns.
    """
    timetable = plan.timetable(classes)
    arrangement = Arrangement(
        environment=environment,
        idle_us=plan.idle_us,
        wake=plan.wake,
        period_us=plan.period_us,
        timetable=timetable,
        timed=timed,
        unload_accepting=plan.unload_accepting,
        library=library,
        on_error=plan.on_error,
        watchdog_ms=plan.watchdog_ms,
        realtime=plan.realtime,
        cpu=plan.cpu,
        grace_s=plan.grace_s,
    )
    planned = list(zip(classes.items(), plan.machines, strict=True))
    if timetable is None:
        planned.sort(key=lambda each: each[1].suspended)
    for (name, cls), machine in planned:
        if not machine.preload:
            load = arrangement.load_suspended if machine.suspended else arrangement.load
            load(cls, name=name, variables=machine.variables, slots=machine.slots)
    return arrangement


def _check_plan(plan: Plan) -> None:
    if not plan.machines:
        raise ConfigurationError("it names no [[machine]] to run")
    timed = [planned.period_us is not None for planned in plan.machines]
    for number, planned in enumerate(plan.machines):
        where = ("machine", number)
        if planned.period_us is not None and plan.period_us is not None:
            raise ConfigurationError(
                "give one period_us for all machines, above them, or one to each machine",
                (*where, "period_us"),
            )
        if planned.period_us is None and any(timed):
            raise ConfigurationError("needs a period_us, as other machines have one", where)
        if planned.period_us is None and (planned.deadline_us or planned.start_us):
            raise ConfigurationError("start_us and deadline_us need a period_us", where)
        if planned.suspended and planned.preload:
            raise ConfigurationError("is either loaded suspended or preloaded, not both", where)
        if planned.preload and (planned.name or planned.variables or planned.slots):
            raise ConfigurationError(
                "is only preloaded: what loads it gives it name, variables and slots", where
            )
        _check_turns((planned,), where)
    _check_turns(plan.machines, ("machine",))


def _check_turns(machines: tuple[PlannedMachine, ...], where: tuple[str | int, ...]) -> None:
    try:
        Plan(machines=machines).timetable(each.name or each.definition for each in machines)
    except ScheduleError as error:
        raise ConfigurationError(str(error), where) from error


# TOML files as typed structs


def read_toml(file: Path, kind: type[T], check: Callable[[T], None] = lambda _: None) -> T:
    """Read a TOML file as a `kind`, a msgspec Struct.

    `check` may raise `ConfigurationError` with a `where` path, as ("machine", 1, "name"), for
    faults that the types cannot express. Raise `ConfigurationError` with file and line for every
    fault.
    """
    text = read_text(file)
    try:
        value = msgspec.convert(tomllib.loads(text), kind)
        check(value)
    except tomllib.TOMLDecodeError as error:
        what, _, place = str(error).partition(" (at ")
        found = re.match(r"line (\d+)", place)
        line = int(found[1]) if found else text.rstrip("\n").count("\n") + 1
        raise ConfigurationError(what, file=file, line=line) from error
    except RecursionError as error:
        raise ConfigurationError("is nested too deeply", file=file) from error
    except msgspec.ValidationError as error:
        found = _WHERE.search(str(error))
        where = _steps(found[1]) if found else ()
        what = _WHERE.sub("", str(error))
        unknown = re.search(r"unknown field `(.*)`", what)
        key = unknown and unknown[1]
        if key is not None:
            keys = {field.encode_name for field in _fields(kind)}
            near = "; another table has it" if key in keys else did_you_mean(key, keys)
            what = f"there is no key {key!r} here{near}"
        else:
            what += _remedy(what, where, kind)
        raise _located(what, file, text, where, key) from error
    except ConfigurationError as error:
        raise _located(error.what, file, text, error.where) from error
    except ValueError as error:  # a number of thousands of digits
        raise ConfigurationError(str(error), file=file) from error
    return value


def read_text(file: Path) -> str:
    """Read a text file; raise `ConfigurationError` if it cannot be read as UTF-8."""
    try:
        return file.read_text(encoding="utf-8")
    except OSError as error:
        why = f"{error.strerror}{nearby_file(file)}"
        raise ConfigurationError(f"cannot be read: {why}", file=file) from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"is not UTF-8 text: {error.reason}", file=file) from error


def line_of(text: str, where: Path_) -> int | None:
    """Find the line, from 1, where the value at `where` in a TOML text begins.

    If there is no such value, it is the line of the innermost table or array on the path, or None.
    The parser finds it: the shortest document of leading lines that has the value ends with its
    last line, and the value begins after the longest document without it.
    """
    lines = text.split("\n")

    def document(end: int) -> dict[str, Any] | None:
        try:
            return tomllib.loads("\n".join(lines[:end]))
        except ValueError:  # in the middle of a value
            return None

    for length in range(len(where), 0, -1):
        if not _has(document(len(lines)), where[:length]):
            continue
        without, within = 0, len(lines)  # so many lines lack the value; have it
        while within - without > 1:
            middle = end = (without + within) // 2
            while end < within and (found := document(end)) is None:
                end += 1
            if end == within or _has(found, where[:length]):
                within = middle
            else:
                without = end
        rest = enumerate(lines[without:], without + 1)
        return next(n for n, line in rest if line.strip() and line.strip()[0] != "#")
    return None


def _has(value: Any, where: Path_) -> bool:
    for step in where:
        if isinstance(step, int):
            if not (isinstance(value, list) and step < len(value)):
                return False
        elif not (isinstance(value, dict) and step in value):
            return False
        value = value[step]
    return True


def _located(
    what: str, file: Path, text: str, where: Path_, key: str | None = None
) -> ConfigurationError:
    line = line_of(text, where if key is None else (*where, key))
    place = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in where)
    return ConfigurationError(
        f"{place.lstrip('.')}: {what}" if place else what, where, file=file, line=line
    )


def _remedy(what: str, where: Path_, kind: Any) -> str:
    """Suggest, for the end of a message, a value of a `kind` in place of one that is refused."""
    if wrong := re.match(r"Invalid enum value (.*)", what):
        known = _choices(kind, where)
        near = did_you_mean(wrong[1].strip("'"), known)
        return f"; not one of {', '.join(map(repr, known))}{near}" if known else ""
    if missing := re.search(r"missing required field `(.*)`", what):
        return f"; add {missing[1]} = ..."
    found = re.match(r"Expected `(.*)`.*, got `(.*)`", what)
    if found is None:
        return ""
    wanted, got = found[1].split(" | "), found[2]
    if "array" in wanted:
        name = where[-1] if where else ""
        return f"; write [[{name}]], not [{name}]" if got == "object" else "; write [...]"
    if "object" in wanted:
        return "; write a table, as {key = value}"
    if "str" in wanted:
        return "; write it in quotes"
    return "; write it without quotes" if got == "str" else ""


def _choices(kind: Any, where: Path_) -> list[str]:
    """List the texts that a value in a `kind` can be, by its key on whatever level."""
    types = [field.type for field in _fields(kind) if field.encode_name == (where or ("",))[-1]]
    types += [each for found in types for each in getattr(found, "types", ())]
    literals = (each for each in types if isinstance(each, msgspec.inspect.LiteralType))
    return [value for each in literals for value in each.values if isinstance(value, str)]


def _fields(kind: Any) -> list[msgspec.inspect.Field]:
    """List the fields of all tables in a `kind`, on whatever level."""
    fields: list[msgspec.inspect.Field] = []
    todo, seen = [msgspec.inspect.type_info(kind)], set[int]()
    while todo:
        found: Any = todo.pop()
        if isinstance(found, msgspec.inspect.StructType):
            if id(found.cls) not in seen:
                seen.add(id(found.cls))
                fields += found.fields
                todo += [field.type for field in found.fields]
        else:
            names = ("types", "item_types", "item_type", "value_type")
            for part in (getattr(found, name, ()) for name in names):
                todo += part if isinstance(part, tuple) else (part,)
    return fields


def _steps(path: str) -> Path_:
    """Split msgspec's path ``$.machine[1].name`` into steps; `...` ends them."""
    steps: list[str | int] = []
    for index, name in _STEP.findall(path[1:]):
        if index == "...":
            break
        steps.append(int(index) if index else name)
    return tuple(steps)


# Dispatch tables


class DispatchTable(Plan, frozen=True, kw_only=True):
    """A plan with its own timetable: (machine, start_us) for each slot.

    Machines are numbered from 0. The cycle is the shortest multiple of the periods of all machines
    with slots that has room for all slots.
    """

    slots: tuple[tuple[int, int], ...]

    def timetable(self, names: Iterable[str]) -> Timetable:
        """Make the timetable for machines of these names; log a warning for a wrong period."""
        names = tuple(names)
        slots = [
            TimeSlot(names[number], start_us, self.machines[number].deadline_us or 1)
            for number, start_us in self.slots
        ]
        even_us = lcm(*(self.machines[number].period_us or 1 for number, _ in self.slots))
        length_us = slots[-1].start_us - slots[0].start_us
        cycle_us = (length_us // even_us + 1) * even_us
        for number, turns in Counter(number for number, _ in self.slots).items():
            period_us = self.machines[number].period_us
            if period_us is not None and turns * period_us != cycle_us:
                logger().warning(
                    "%s has a period of %d us, but the table gives it %d turns in %d us",
                    names[number],
                    period_us,
                    turns,
                    cycle_us,
                )
        return Timetable(slots, cycle_us)


def read_dispatch_table(file: Path) -> DispatchTable:
    """Read a dispatch table; raise `ConfigurationError` with the line of what is wrong."""
    lines = read_text(file).split("\n")
    numbered = [(number, line.rstrip()) for number, line in enumerate(lines, 1)]
    blank = next((number for number, line in numbered if not line), len(lines))
    try:
        machines = tuple(_machine(number, line) for number, line in numbered[:blank] if line)
        slots = [
            (number, *_slot(number, line, len(machines)))
            for number, line in numbered[blank:]
            if line
        ]
        _check_slots(machines, slots)
    except _LineError as error:
        line, what = error.args
        raise ConfigurationError(what, file=file, line=line) from error
    return DispatchTable(machines=machines, slots=tuple(slot[1:] for slot in slots))


class _LineError(Exception):
    """The number of a line, and what is wrong with it."""


def _machine(line: int, text: str) -> PlannedMachine:
    fields = text.split("\t")
    if len(fields) not in (3, 4):
        raise _LineError(
            line, f"{text!r} is not: bundle, period and deadline in us, S or P; tab-separated"
        )
    path, period, deadline, *how = fields
    definition = os.path.expanduser(path)
    if not path or definition[0] == "~":
        raise _LineError(line, f"{path!r} is not the path of a bundle")
    if how not in ([], ["S"], ["P"]):
        raise _LineError(line, f"{how[0]!r} must be S (suspended) or P (preloaded)")
    return PlannedMachine(
        definition=definition,
        period_us=_number(line, "the period", period, 1),
        deadline_us=_number(line, "the deadline", deadline, 1),
        suspended=how == ["S"],
        preload=how == ["P"],
    )


def _slot(line: int, text: str, machines: int) -> tuple[int, int]:
    fields = text.split("\t")
    if len(fields) != 2:
        raise _LineError(line, f"{text!r} is not: number of a machine, start in us; tab-separated")
    machine = _number(line, "the machine", fields[0], 0)
    if machine >= machines:
        raise _LineError(line, f"there is no machine {machine}; they are 0 to {machines - 1}")
    return machine, _number(line, "the start", fields[1], 0)


def _number(line: int, what: str, text: str, least: int) -> int:
    if not _NUMBER.fullmatch(text) or int(text) < least:
        raise _LineError(line, f"{what} is {text!r}; it must be a whole number from {least}")
    return int(text)


def _check_slots(machines: tuple[PlannedMachine, ...], slots: list[tuple[int, int, int]]) -> None:
    if not slots:
        raise _LineError(len(machines) or 1, "after a blank line, a table of slots must follow")
    for (_, _, before), (line, _, start) in pairwise(slots):
        if start < before:
            raise _LineError(line, f"starts at {start} us, before the slot above it, at {before}")
    used = {machine for _, machine, _ in slots}
    for number, planned in enumerate(machines):
        if number not in used and not planned.preload:
            raise _LineError(number + 1, f"{planned.definition} has no slot in the second table")
