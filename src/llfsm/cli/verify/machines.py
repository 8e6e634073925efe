"""What is to be verified: machines and properties as the command line and files name them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import msgspec
from msgspec.structs import replace

from llfsm.cli.machines import ResolvedPlan, find_object, parse_arguments
from llfsm.errors import did_you_mean
from llfsm.runtime.plans import Plan, PlannedMachine, Verification
from llfsm.runtime.verification import NO_FAILURE, Member, Property
from llfsm.runtime.verification.domains import domain_of

if TYPE_CHECKING:
    from llfsm.whiteboard import Slot


_FILE = ".toml"


class _Named(NamedTuple):
    """A property and its name in a module, as ``module:name``."""

    where: str
    property: Property


class VerifiedMachines:
    """Machines and what is to be verified of them; `asked` goes before what a file has.

    Raise ``click.UsageError`` for what cannot be found, and `DomainError`.
    """

    def __init__(self, machines: Sequence[str], asked: Verification):
        resolved = parse_arguments(machines, None, (), ())
        files = [Path(text) for text in machines if text.endswith(_FILE)]
        self.folder = files[0].absolute().parent if files else Path.cwd()
        self._folders = [self.folder, Path()]
        self._resolved = resolved
        self.members = tuple(self._members())
        wanted = _joined(resolved.plan.verify or Verification(), asked)
        self.wanted = wanted
        self.period_ms = _period_ms(wanted, resolved)
        named = {NO_FAILURE: _Named("llfsm.runtime.verification:NO_FAILURE", NO_FAILURE)}
        for each in self._properties(wanted.properties):  # which may name one twice
            named.setdefault(each.property, each)
        self.named = [*named.values()]

    def plan_with(self, members: Sequence[Member]) -> Plan:
        """Return the plan by which machines run again: without times, but with what watches."""
        plan = self._resolved.plan
        watching = [each.machine for each in members[len(self.members) :]]
        more = [PlannedMachine(definition=f"{m.__module__}:{m.__qualname__}") for m in watching]
        return replace(plan, period_us=None, verify=None, machines=(*plan.machines, *more))

    def options(self) -> dict[str, Any]:
        """Return the arguments of `explore`, without machines and properties."""
        wanted = self.wanted
        return {
            "period_ms": self.period_ms,
            "any_time": wanted.any_time,
            "sensors": dict(self._sensors(wanted.sensors)),
            "stop": wanted.stop,
            "suspend": wanted.suspend,
            "choices": wanted.choices,
            "abstract": {name: self._callable(where) for name, where in wanted.abstract.items()},
            "unload_accepting": self._resolved.plan.unload_accepting,
            "max_states": wanted.max_states,
            "max_seconds": wanted.max_seconds,
        }

    def _members(self) -> Iterator[Member]:
        planned = zip(self._resolved.classes.values(), self._resolved.plan.machines, strict=True)
        for cls, each in planned:
            if each.preload:
                raise click.UsageError(
                    f"{each.definition} is preloaded: machines that load others while they run "
                    f"cannot be verified"
                )
            if each.period_us is not None:
                raise click.UsageError(
                    f"{each.definition} has a period of its own: timetables cannot be verified; "
                    f"give one period to all machines"
                )
            yield Member(cls, each.name, each.variables, each.slots, each.suspended)

    def _properties(self, names: Iterable[str]) -> Iterator[_Named]:
        for name in names:
            module, found = find_object(name, self._folders)
            where = module.__name__
            if isinstance(found, Property):
                yield _Named(f"{where}:{name.rpartition(':')[2]}", found)
                continue
            every = {each: value for each, value in vars(module).items() if _is_property(value)}
            if not isinstance(found, ModuleType):
                raise click.UsageError(
                    f"{name}: {found!r} is not a property; those of {where}: "
                    f"{', '.join(every) or 'none'}"
                )
            if not every:
                raise click.UsageError(f"{name}: {where} defines no properties")
            for each, value in every.items():
                yield _Named(f"{where}:{each}", value)

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
        """Return the slots that sensors read, by the names that they have on the board."""
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


def _is_property(value: object) -> bool:
    return isinstance(value, Property)


def _period_ms(wanted: Verification, resolved: ResolvedPlan) -> float | None:
    """Return the time from round to round; None for any."""
    if wanted.any_time:
        return wanted.period_ms  # an error, if there is one
    period_us = resolved.plan.period_us or resolved.plan.idle_us
    if wanted.period_ms is None and period_us == 0:
        raise click.UsageError(
            "rounds follow each other at once (idle_us = 0): give --period-ms or --any-time"
        )
    return wanted.period_ms or period_us / 1e3


def _joined(file: Verification, asked: Verification) -> Verification:
    """Return what a file asks for, with what the command line asks for in its place or added."""
    given = {
        name: value
        for name in asked.__struct_fields__
        if (value := getattr(asked, name)) != getattr(Verification(), name)
    }
    for name in ("sensors", "abstract"):
        given[name] = {**getattr(file, name), **getattr(asked, name)}
    given["properties"] = tuple(dict.fromkeys((*file.properties, *asked.properties)))
    given["suspend"] = tuple(dict.fromkeys((*file.suspend, *asked.suspend)))
    return msgspec.structs.replace(file, **given)
