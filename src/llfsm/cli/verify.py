"""``llfsm verify``: explore machines, and decide what must never or always hold of them.

The command line and a file's table [verify] together name machines, properties and domains
(`VerifiedMachines`). The result is reported as text or JSON; counterexamples become recordings and
tests.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import click
import msgspec
from msgspec.structs import replace

from llfsm.cli.echo import echo
from llfsm.cli.machines import ResolvedPlan, find_object, parse_arguments
from llfsm.cli.options import Integer, Number, file_option
from llfsm.errors import LlfsmError, did_you_mean
from llfsm.runtime.counterexamples import regression_of, script_of, story_of
from llfsm.runtime.log import logger
from llfsm.runtime.plans import DispatchTable, Plan, PlannedMachine, Verification
from llfsm.runtime.verification import (
    NO_FAILURE,
    ExploreOptions,
    Member,
    Progress,
    Property,
    Space,
    Verdict,
    explore,
    reachable,
)
from llfsm.runtime.verification.domains import domain_of
from llfsm.runtime.verification.space import EXPORTS, VERDICTS

if TYPE_CHECKING:
    from llfsm.runtime.engine.schedule import Timetable
    from llfsm.whiteboard import Slot

_OF_PLANS = frozenset(
    {
        *("machines", "period_us", "idle_us", "unload_accepting", "on_error", "verify"),
        *(
            "board",
            "wake",
            "realtime",
            "cpu",
            "debug_clock",
            "breakpoints",
            "will_after_ms",
            "grace_s",
        ),
    }
)
_COVERED: Final[dict[type, frozenset[str]]] = {
    Plan: _OF_PLANS,
    DispatchTable: _OF_PLANS | {"slots"},
    PlannedMachine: frozenset(
        {
            *("definition", "name", "suspended", "variables", "slots"),
            *("period_us", "start_us", "deadline_us"),
        }
    ),
}
"""The options of a file that an exploration takes as they are, or that change nothing of it.

Those of the second line change where and when machines run, but not what they do in their rounds.
"""
_ASSUMED: Final = {
    "watchdog_ms": "no code runs for longer than watchdog_ms, so that no watchdog posts",
    "on_pause": "no debugger pauses the machines, and posts safe values",
}
"""What is assumed where such an option is set, as no exploration includes it."""
_REFUSED: Final = {
    "preload": "is preloaded, to be loaded by its name while others run: this cannot be verified",
}
"""Why options cannot be verified. Any that is in none of these tables is refused, too."""
_EVERYTHING = reachable(lambda _: False, "every state")
"""A property that is not decided before all states are found, as an export needs them."""
_SHOWN_S = 0.1  # from one update of the progress to the next
_STDOUT = Path("-")
_RECORDING = ".mcap"
_FILE = ".toml"


class _Refused(click.ClickException):
    """The verification cannot be done as asked: no property is decided."""

    exit_code = 2


class _Interrupted(click.ClickException):
    """Ctrl-C came before or after the exploration: some property is undecided."""

    exit_code = 3


def _pairs(
    _: click.Context, option: click.Parameter, texts: Iterable[str], read: Callable[[str], Any]
) -> dict[str, Any]:
    """Read texts of the form that the option's metavar shows."""
    pairs = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise click.UsageError(f"{text!r}: give it as {option.metavar}")
        pairs[name] = read(value)
    return pairs


def _json(text: str) -> Any:
    """Read a domain of the command line: JSON, or a word as it is."""
    if text[:1] not in ("[", "{"):
        return text
    try:
        return msgspec.json.decode(text)
    except msgspec.DecodeError as error:
        raise click.UsageError(f"{text!r} is not JSON: {error}") from error


@click.command()
@click.argument("machines", nargs=-1, metavar="MACHINE...")
@click.option(
    "-T",
    "table",
    metavar="TABLE",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Explore the machines of a dispatch table, each at its times.",
)
@click.option(
    "-p",
    "--property",
    "properties",
    metavar="MODULE:NAME",
    multiple=True,
    help="A property to decide, or MODULE for all that it defines. May be repeated.",
)
@click.option(
    "--sensor",
    "sensors",
    metavar="SLOT=DOMAIN",
    multiple=True,
    callback=partial(_pairs, read=_json),
    help="What the environment may put into SLOT: every, JSON, or MODULE:NAME.",
)
@click.option(
    "--period-ms",
    metavar="MS",
    type=Number(0, min_open=True),
    help="The time from one round to the next; by default the file's period_us, else any.",
)
@click.option("--any-time", is_flag=True, help="Any time may pass between two rounds.")
@click.option("--skips", is_flag=True, help="Any number of rounds of the period may be left out.")
@click.option(
    "--choices",
    type=click.Choice(["turns", "rounds"]),
    default="turns",
    help="When the environment may change: at each turn (the default), or once a round.",
)
@click.option("--stop", is_flag=True, help="A stop, as by Ctrl-C, may come before any turn.")
@click.option(
    "--suspend",
    metavar="MACHINE",
    multiple=True,
    help="Anybody may suspend, resume or restart MACHINE at any time. May be repeated.",
)
@click.option(
    "--elsewhere",
    metavar="MACHINE=STATE,...|MODULE:NAME",
    multiple=True,
    callback=partial(_pairs, read=str),
    help="The states of a machine of another process, none if not there, or its class.",
)
@click.option(
    "--abstract",
    metavar="MACHINE.VARIABLE=MODULE:FUNCTION",
    multiple=True,
    callback=partial(_pairs, read=str),
    help="Replace a variable's value by the function's result after each turn.",
)
@click.option("--max-states", metavar="N", type=Integer(1), help="Stop after N states.")
@click.option("--max-seconds", metavar="S", type=Number(0), help="Stop after S seconds.")
@file_option(
    "--record",
    "recording",
    help="Record the first counterexample, for llfsm view and llfsm rerun.",
)
@file_option("--pytest", "tests", help="Write a test for each counterexample; - prints them.")
@file_option(
    "--export",
    "exports",
    multiple=True,
    help="Write all states for Storm (.drn), SPIN (.pml) or Aldebaran (.aut). May be repeated.",
)
@click.option("--full", is_flag=True, help="Show all rows of counterexamples.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object.")
def verify(
    machines: tuple[str, ...],
    table: Path | None,
    recording: Path | None,
    tests: Path | None,
    exports: tuple[Path, ...],
    full: bool,
    as_json: bool,
    **asked: Any,
) -> None:
    """Explore everything that MACHINES can do, and decide whether properties hold.

    Machines are named as for `llfsm run`; for an arrangement file, its table [verify] applies,
    too. The exit status is 0 if all properties hold, 1 if one is violated, 2 for wrong usage, and 3
    if one is undecided because --max-states, --max-seconds or Ctrl-C stopped the exploration.

    \b
    llfsm verify OvenTimer OvenCooker -p oven_properties:no_radiation
    llfsm verify robot.toml --record counterexample.mcap
    """
    _check_files(recording, tests, exports)
    try:
        subject = VerifiedMachines(machines, Verification(**asked), table)
        sought = [each.property for each in subject.named]
        with _progress(quiet=as_json) as progress, _unprinted():
            options: ExploreOptions = {**subject.options(), "progress": progress}
            space = explore(
                subject.members,
                properties=[*sought, *([_EVERYTHING] if exports else [])],
                **options,
            )
        verdicts = [each for each in space.verdicts if each.property is not _EVERYTHING]
        undecided = any(verdict.holds is None for verdict in verdicts)
        ended = _why(subject.wanted, space) if undecided else ""
        with _unprinted():
            if as_json:
                text = msgspec.json.encode(as_data(space, verdicts, subject, ended)).decode()
            else:
                text = as_text(space, verdicts, subject, ended, full=full)
        echo(text)
        violated = [verdict for verdict in verdicts if verdict.holds is False]
        _write(subject, space, violated, recording, tests)
        for file in exports:
            space.export(file)
    except LlfsmError as error:
        raise _Refused(str(error)) from error
    except KeyboardInterrupt:
        raise _Interrupted("interrupted: nothing more is known") from None
    if violated or undecided:
        raise click.exceptions.Exit(1 if violated else 3)


def _check_files(recording: Path | None, tests: Path | None, exports: Sequence[Path]) -> None:
    """Refuse files that cannot be written, before anything is explored."""
    for file in exports:
        if file.suffix not in EXPORTS:
            raise click.UsageError(f"{file}: its name must end with one of {', '.join(EXPORTS)}")
    if recording is not None and recording.suffix != _RECORDING:
        raise click.UsageError(f"{recording}: its name must end with {_RECORDING}")
    for each in (recording, tests):
        if each is not None and each != _STDOUT and each.exists():
            raise _Refused(f"{each} is there already: remove it, or write to another file")
    for each in (recording, tests, *exports):
        if each is not None and not each.absolute().parent.is_dir():
            raise _Refused(f"{each} cannot be written: there is no folder {each.parent}")


@contextmanager
def _progress(*, quiet: bool) -> Iterator[Callable[[Progress], object]]:
    """Give a function that shows the progress in a line on a terminal, unless `quiet`."""
    from rich.console import Console

    console = Console(stderr=True, quiet=quiet or not sys.stderr.isatty())
    with console.status("exploring") as status:
        shown = 0.0

        def show(now: Progress) -> None:
            nonlocal shown
            if now.seconds - shown >= _SHOWN_S:
                shown = now.seconds
                status.update(
                    f"{now.states:,} states, {now.depth:,} turns deep, {now.seconds:.0f} s"
                )

        yield show


def _why(wanted: Verification, space: Space) -> str:
    """Name the cause that ended an exploration before its end."""
    if wanted.max_states is not None and space.states >= wanted.max_states:
        return f"there are {wanted.max_states:,} or more (max_states)"
    if wanted.max_seconds is not None and space.seconds >= wanted.max_seconds:
        return f"it took longer than {wanted.max_seconds:g} s (max_seconds)"
    if space.short_of_memory:
        return "little memory is left"
    if space.cut:
        return "interrupted"
    if space.complete and any(
        NO_FAILURE is e.property and e.holds is False for e in space.verdicts
    ):
        return (
            'all ends where code raises, and what would follow is not known (on_error = "suspend")'
        )
    return "the times of the way to a violation are not possible; give --period-ms"


@contextmanager
def _unlogged() -> Iterator[None]:
    """Keep what code raises out of the log, while a counterexample runs again: its table has it."""
    log = logger()
    before, log.disabled = log.disabled, True
    try:
        yield
    finally:
        log.disabled = before


@contextmanager
def _unprinted() -> Iterator[None]:
    """Drop what machines print, which are run thousands of times."""
    with Path(os.devnull).open("w") as nothing, redirect_stdout(nothing):
        yield


@_unlogged()
def _write(
    subject: VerifiedMachines,
    space: Space,
    violated: Sequence[Verdict],
    recording: Path | None,
    tests: Path | None,
) -> None:
    """Write the counterexamples, the first as a recording and all as tests; report the files."""
    ways = [(each, each.witness) for each in violated if each.witness is not None]
    if not ways:
        shown = "no run shows that a state is not reachable" if violated else "nothing is violated"
        for file in (recording, tests):
            if file is not None:
                echo(f"{file}: not written, as {shown}", err=True)
        return
    if recording is not None:
        from llfsm.bridges.recording.recorders import record_script

        first, way = ways[0]
        with _unprinted():
            record_script(
                recording,
                space.members,
                script_of(way, space),
                plan=subject.plan_with(space.members, space.timetable),
                folder=subject.folder,
                unload_accepting=space.unload_accepting,
                on_error=space.on_error,
                timetable=space.timetable,
            )
        echo(f"{recording}: recorded how {first.property} is violated", err=True)
    if tests is not None:
        where = {each.property: each.where for each in subject.named}
        folder = None if tests == _STDOUT else tests.absolute().parent
        with _unprinted():
            text = "\n\n".join(
                regression_of(space, witness, where[each.property], folder=folder)
                for each, witness in ways
            )
        if tests == _STDOUT:
            click.echo(text, nl=False)  # a file
        else:
            tests.write_text(text, encoding="utf-8")
            echo(f"{tests}: fails under pytest until the machines are mended", err=True)


# The machines, and the properties to decide


class _Named(NamedTuple):
    """A property and its name in a module, as ``module:name``."""

    where: str
    property: Property


class VerifiedMachines:
    """Machines and properties to decide; the options `asked` go before those of a file."""

    def __init__(self, machines: Sequence[str], asked: Verification, table: Path | None = None):
        resolved = parse_arguments(machines, table)
        self.assumed = tuple(assumed_of(resolved.plan))
        """Describe the assumptions because of options of a file."""
        files = [Path(text) for text in machines if text.endswith(_FILE)]
        self.folder = files[0].absolute().parent if files else Path.cwd()
        self._folders = [self.folder, Path()]
        self._resolved = resolved
        self.members = tuple(self._members())
        wanted = _joined(resolved.plan.verify or Verification(), asked)
        self.wanted = wanted
        self.period_ms = _period_ms(wanted, resolved)
        self.timetable = resolved.plan.timetable(resolved.classes)
        """When each machine has its turns; None unless the exploration is to have it."""
        self.not_covered = tuple(self._other_runs())
        """Runs of these machines that have another schedule, in words."""
        named = {NO_FAILURE: _Named("llfsm.runtime.verification:NO_FAILURE", NO_FAILURE)}
        for each in self._properties(wanted.properties):  # which may name one twice
            named.setdefault(each.property, each)
        self.named = [*named.values()]

    def plan_with(self, members: Sequence[Member], timetable: Timetable | None) -> Plan:
        """Make the plan by which the machines run again, with the monitors, and no period.

        With the `timetable` of all of them it is a dispatch table.
        """
        plan = self._resolved.plan
        watching = [each.machine for each in members[len(self.members) :]]
        more = [PlannedMachine(definition=f"{m.__module__}:{m.__qualname__}") for m in watching]
        machines = (*plan.machines, *more)
        names = [*self._resolved.classes, *(m.__name__ for m in watching)]
        if timetable is None:
            untimed = {"period_us": None, "deadline_us": None, "start_us": 0}
            machines = tuple(replace(each, **untimed) for each in machines)
            return replace(plan, period_us=None, verify=None, machines=machines)
        same = {n: getattr(plan, n) for n in Plan.__struct_fields__}
        slots = tuple((names.index(s.machine), s.start_us) for s in timetable.slots)
        return DispatchTable(**{**same, "verify": None, "machines": machines, "slots": slots})

    def _other_runs(self) -> Iterator[str]:
        """Say that a run of the same machines has another schedule than that which is asked for."""
        period_ms, period_us = self.period_ms, self._resolved.plan.period_us
        if self.timetable is not None and (period_ms is not None or self.wanted.any_time):
            self.timetable = None
            yield "runs with the file's own timetable"
        elif period_ms is not None and period_us is None:
            yield "runs without a period, as llfsm run has by itself"
        elif period_ms is not None and period_us is not None and period_ms * 1e3 != period_us:
            yield f"runs with the file's own period, {period_us / 1e3:g} ms"

    def options(self) -> ExploreOptions:
        """List the arguments of `explore`, without machines and properties."""
        wanted = self.wanted
        return {
            "period_ms": self.period_ms,
            "timetable": self.timetable,
            "any_time": wanted.any_time,
            "skips": wanted.skips,
            "sensors": dict(self._sensors(wanted.sensors)),
            "stop": wanted.stop,
            "suspend": wanted.suspend,
            "elsewhere": {name: self._states(each) for name, each in wanted.elsewhere.items()},
            "choices": wanted.choices,
            "abstract": {name: self._callable(where) for name, where in wanted.abstract.items()},
            "unload_accepting": self._resolved.plan.unload_accepting,
            "on_error": self._resolved.plan.on_error,
            "max_states": wanted.max_states,
            "max_seconds": wanted.max_seconds,
        }

    def _members(self) -> Iterator[Member]:
        planned = zip(self._resolved.classes.values(), self._resolved.plan.machines, strict=True)
        for cls, each in planned:
            yield Member(cls, each.name, each.variables, each.slots, each.suspended)

    def _properties(self, names: Iterable[str]) -> Iterator[_Named]:
        for name in names:
            module, found = find_object(name, self._folders)
            where = module.__name__
            if isinstance(found, Property):
                yield _Named(f"{where}:{name.rpartition(':')[2]}", found)
                continue
            every = {
                each: value for each, value in vars(module).items() if isinstance(value, Property)
            }
            if not isinstance(found, ModuleType):
                raise click.UsageError(
                    f"{name}: {found!r} is not a property; those of {where}: "
                    f"{', '.join(every) or 'none'}"
                )
            if not every:
                raise click.UsageError(f"{name}: {where} defines no properties")
            for each, value in every.items():
                yield _Named(f"{where}:{each}", value)

    def _states(self, given: str | Sequence[str]) -> Any:
        """Find what a machine of another process is: a class, or a list of states."""
        if isinstance(given, str) and ":" in given:
            return find_object(given, self._folders)[1]
        states = given.split(",") if isinstance(given, str) else given
        return [None if state == "none" else state for state in states]

    def _sensors(self, given: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        slots = self._slots()
        for name, domain in given.items():
            if name not in slots:
                raise click.UsageError(
                    f"no machine reads a slot {name!r}; they read: {', '.join(slots) or 'none'}"
                    f"{did_you_mean(name, slots)}"
                )
            if isinstance(domain, str) and ":" in domain:
                yield name, find_object(domain, self._folders)[1]
            else:
                yield name, domain_of(slots[name], domain)

    def _slots(self) -> dict[str, Slot[Any]]:
        """Find the slots that sensors read, by the names that they have on the board."""
        slots: dict[str, Slot[Any]] = {}
        for cls, each in zip(
            self._resolved.classes.values(), self._resolved.plan.machines, strict=True
        ):
            for sensor in cls.table.sensors.values():
                slots[each.slots.get(sensor.slot.name, sensor.slot.name)] = sensor.slot
        return slots

    def _callable(self, where: str) -> Any:
        found = find_object(where, self._folders)[1]
        if not callable(found):
            raise click.UsageError(f"{where}: {found!r} is not a function")
        return found


def assumed_of(plan: Plan) -> Iterator[str]:
    """Yield what is assumed of a plan; refuse options of it that are not explored."""
    for given, what in ((plan, "the file"), *((each, each.definition) for each in plan.machines)):
        for field in msgspec.structs.fields(given):
            name = field.name
            if name in _COVERED.get(type(given), ()) or getattr(given, name) == field.default:
                continue
            if name not in _ASSUMED:
                why = f"has {name!r}, which no exploration includes: leave it out"
                raise click.UsageError(f"{what} {_REFUSED.get(name, why)}")
            yield _ASSUMED[name]


def _period_ms(wanted: Verification, resolved: ResolvedPlan) -> float | None:
    """Choose the time from round to round, in ms, as a run of the file has it; None for any."""
    period_us = resolved.plan.period_us
    if wanted.any_time or wanted.period_ms is not None or period_us is None:
        return wanted.period_ms  # an error, if the command line has both
    return period_us / 1e3


def _joined(file: Verification, asked: Verification) -> Verification:
    """Join the options of a file and of the command line, which replace or add to them."""
    given = {
        name: value
        for name in asked.__struct_fields__
        if (value := getattr(asked, name)) != getattr(Verification(), name)
    }
    for name in ("sensors", "elsewhere", "abstract"):
        given[name] = {**getattr(file, name), **getattr(asked, name)}
    if asked.any_time and asked.period_ms is None:
        file = replace(file, period_ms=None)
    if asked.period_ms is not None and not asked.any_time:
        file = replace(file, any_time=False)
    given["properties"] = tuple(dict.fromkeys((*file.properties, *asked.properties)))
    given["suspend"] = tuple(dict.fromkeys((*file.suspend, *asked.suspend)))
    return replace(file, **given)


# The report


@_unlogged()
def as_text(
    space: Space,
    verdicts: Sequence[Verdict],
    subject: VerifiedMachines,
    ended: str,
    *,
    full: bool = False,
) -> str:
    """Write the report; `ended` says why not all is decided, "" if it is.

    The schedule comes first, and then verdicts. What is violated is named again below the
    counterexamples.
    """
    left = ", ".join(_not_covered(space, subject))
    lines = [
        f"{space.schedule}; not covered: {left}" if left else space.schedule,
        f"{space.states:,} states, {space.transitions:,} transitions, {space.depth:,} turns deep, "
        f"{space.ringlets:,} ringlets run{_sampled(space)}, in {space.seconds:.1f} s",
    ]
    lines += [f"assumed: {each}" for each in subject.assumed]
    if ended:
        lines.append(f"not all is decided: {ended}")
        lines += space.hints()
    for verdict in verdicts:
        why = ": what triggers it never happens" if verdict.vacuous else ""
        lines.append(f"{VERDICTS[verdict.holds]}: {verdict.property}{why}")
    if space.complete:
        lines += [f"never reached: {each}" for each in space.unreached]
        lines += [f"never taken: {each}" for each in space.untaken]
    violated = [verdict for verdict in verdicts if verdict.holds is False]
    for verdict in violated:
        if verdict.witness is not None:
            lines += ["", f"{verdict.property}: violated"]
            lines += [f"  {line}" for line in story_of(space, verdict.witness, full=full)]
    if violated:
        names = ", ".join(str(verdict.property) for verdict in violated)
        lines += ["", f"{len(violated)} of {len(verdicts)} violated: {names}"]
    return "\n".join(lines)


def _not_covered(space: Space, subject: VerifiedMachines) -> list[str]:
    """List what runs may do that was not explored."""
    return [*([space.not_covered] if space.not_covered else []), *subject.not_covered]


def _sampled(space: Space) -> str:
    """Write how many ringlets were run again, unless all were, or the exploration ended early."""
    if not 0 < space.repeated < space.ringlets:
        return ""
    return f" ({space.repeated:,} of them again, to see whether they do the same)"


def as_data(
    space: Space, verdicts: Sequence[Verdict], subject: VerifiedMachines, ended: str
) -> Any:
    """Make the report as data for JSON; `ended` is as for `as_text`."""
    return {
        "states": space.states,
        "transitions": space.transitions,
        "depth": space.depth,
        "ringlets": space.ringlets,
        "repeated": space.repeated,
        "seconds": round(space.seconds, 3),
        "period_ms": subject.period_ms,
        "schedule": space.schedule,
        "not_covered": _not_covered(space, subject),
        "assumed": list(subject.assumed),
        "complete": space.complete,
        "ended": ended or None,
        "hints": list(space.hints()) if ended else [],
        "properties": [
            {
                "property": str(verdict.property),
                "kind": verdict.property.kind,
                "verdict": VERDICTS[verdict.holds],
                "vacuous": verdict.vacuous,
                "loop": None if verdict.witness is None else verdict.witness.loop,
                "region": None
                if verdict.witness is None or verdict.witness.region is None
                else verdict.witness.region._asdict(),
                "at_end": {} if verdict.witness is None else dict(verdict.witness.at_end),
                "witness": None
                if verdict.witness is None
                else [msgspec.to_builtins(turn._asdict()) for turn in verdict.witness.turns],
            }
            for verdict in verdicts
        ],
        "unreached": list(space.unreached) if space.complete else [],
        "untaken": list(space.untaken) if space.complete else [],
    }
