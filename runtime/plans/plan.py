"""Plans: which machines to run and how, from a command line, a file or a dispatch table.

An arrangement file is TOML; its keys are the fields of `Plan`, in each `[[machine]]` those of
`PlannedMachine`, and in `[verify]` those of `Verification`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec

from ..engine.arrangement import Arrangement
from ..engine.errors import ConfigurationError, ScheduleError
from ..engine.machine import Machine
from ..engine.schedule import Requirement, Timetable
from .toml_files import read_toml

if TYPE_CHECKING:
    from ..engine.environment import Environment
    from ..engine.loading import Library

__all__ = ["Plan", "PlannedMachine", "Verification", "assemble", "names_of", "read_plan"]

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
        """Return its requirement of a timetable, under `name`; none without a period."""
        if self.period_us is None:
            return []
        starts = (self.start_us,) if isinstance(self.start_us, int) else self.start_us
        deadline_us = self.period_us if self.deadline_us is None else self.deadline_us
        return [Requirement(name, self.period_us, deadline_us, starts)]


class Verification(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is to be verified of the machines, as for `llfsm.runtime.verification.explore`.

    Properties and abstractions are named ``module:name``. `period_ms` is by default that of the
    rounds of a run. A domain is "every", a list of messages, a table of fields, each with "every"
    or a list of values, or ``module:name``.
    """

    properties: tuple[str, ...] = ()
    sensors: dict[str, str | list[Any] | dict[str, Any]] = {}
    period_ms: Annotated[float, msgspec.Meta(gt=0, le=_LONGEST_US / 1e3)] | None = None
    any_time: bool = False
    choices: Literal["turns", "rounds"] = "turns"
    stop: bool = False
    suspend: tuple[str, ...] = ()
    abstract: dict[str, str] = {}
    max_states: Positive | None = None
    max_seconds: Annotated[float, msgspec.Meta(ge=0)] | None = None


class Plan(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Machines in their order, and the schedule of their turns, as for `Arrangement`.

    `will_after_ms` is as for `LiveEnvironment`, `on_pause` and `break` as for `Debugger`; with
    `debug_clock` the clock is a `DebugClock`. `verify` says nothing about a run.
    """

    machines: tuple[PlannedMachine, ...] = msgspec.field(name="machine", default=())
    board: str | None = None
    idle_us: NotNegative = 10_000
    wake: bool = True
    period_us: Positive | None = None
    unload_accepting: bool = True
    on_error: Literal["stop", "suspend"] = "stop"
    watchdog_ms: Positive | None = None
    realtime: Annotated[int, msgspec.Meta(ge=1, le=99)] | None = None
    cpu: NotNegative | None = None
    will_after_ms: Annotated[int, msgspec.Meta(ge=500, le=_LONGEST_US)] | None = None
    on_pause: Literal["keep", "safe"] = "keep"
    debug_clock: bool = False
    breakpoints: tuple[str, ...] = msgspec.field(name="break", default=())
    verify: Verification | None = None

    def timetable(self, names: Iterable[str]) -> Timetable | None:
        """Return the timetable for machines of these names, None if none has a period.

        Raise `ScheduleError` if there is no timetable that meets all periods.
        """
        planned = zip(names, self.machines, strict=True)
        needs = [need for name, machine in planned for need in machine.requirement(name)]
        return Timetable.meeting(needs) if needs else None


def read_plan(file: Path) -> Plan:
    """Read an arrangement file; raise `ConfigurationError` with the line of what is wrong."""
    return read_toml(file, Plan, _check)


def names_of(plan: Plan, classes: Iterable[str]) -> list[str]:
    """Return the name that each machine of the plan gets: a second `P` becomes `P.0`.

    `classes` are the names of their classes. Machines that are only preloaded get their names last.
    """
    names: dict[int, str] = {}
    given = list(enumerate(zip(plan.machines, classes, strict=True)))
    for number, (planned, cls) in sorted(given, key=lambda each: each[1][0].preload):
        name = planned.name or cls
        all_names = [name, *(f"{name}.{count}" for count in range(len(names)))]
        names[number] = next(free for free in all_names if free not in names.values())
    return [names[number] for number in range(len(names))]


def assemble(
    plan: Plan,
    classes: Mapping[str, type[Machine]],
    environment: Environment,
    *,
    library: Library,
    timed: bool = False,
) -> Arrangement:
    """Return the arrangement of a plan with its machines loaded; `classes` are by name, in order.

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
    )
    planned = list(zip(classes.items(), plan.machines, strict=True))
    if timetable is None:
        planned.sort(key=lambda each: each[1].suspended)
    for (name, cls), machine in planned:
        if not machine.preload:
            load = arrangement.load_suspended if machine.suspended else arrangement.load
            load(cls, name=name, variables=machine.variables, slots=machine.slots)
    return arrangement


def _check(plan: Plan) -> None:
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
                "is only preloaded: what loads it gives it name, variables and slots",
                where,
            )
        _check_turns((planned,), where)
    _check_turns(plan.machines, ("machine",))


def _check_turns(machines: tuple[PlannedMachine, ...], where: tuple[str | int, ...]) -> None:
    try:
        Plan(machines=machines).timetable(each.name or each.definition for each in machines)
    except ScheduleError as error:
        raise ConfigurationError(str(error), where) from error
