"""The arguments of ``llfsm run`` as a plan, with the classes of its machines."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import click
import msgspec
from msgspec.structs import replace

from llfsm.cli.machine_names import find_machine_class
from llfsm.errors import did_you_mean
from llfsm.runtime.bundles import SUFFIX
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.plans import Plan, PlannedMachine, names_of, read_dispatch_table, read_plan

_FILE = ".toml"


class ResolvedPlan:
    """A plan with the class of each machine, by the name that it gets, in the plan's order."""

    def __init__(self, plan: Plan, folders: Sequence[Path], source: str = ""):
        found = [_find(planned, folders, source) for planned in plan.machines]
        names = names_of(plan, [cls.__name__ for cls in found])
        self.classes = dict(zip(names, found, strict=True))
        self.plan = plan
        beside = [Path(cls.table.path) for cls in found]
        bundles = [path.parent for path in beside if path.suffix == SUFFIX]
        self.library = _MachineFinder(self.classes.values(), dict.fromkeys([*folders, *bundles]))

    def set(self, texts: Iterable[str]) -> None:
        """Set variables and slots by ``name:variable=value`` and ``name:slot:=other``.

        Raise ``click.UsageError`` for a text that names no machine, variable or slot.
        """
        machines = dict(zip(self.classes, self.plan.machines, strict=True))
        for text in texts:
            place, _, value = text.partition("=")
            name, _, what = place.partition(":")
            if name not in machines:
                known = ", ".join(machines) or "none"
                raise click.UsageError(
                    f"{text!r}: no machine {name!r}; there are: {known}"
                    f"{did_you_mean(name, machines)}"
                )
            planned = machines[name]
            if planned.preload:
                raise click.UsageError(
                    f"{text!r}: {name} is only preloaded; the machine that loads it sets that"
                )
            if what.endswith(":"):
                slot = _slot(text, name, self.classes[name], what[:-1])
                machines[name] = replace(planned, slots={**planned.slots, slot: value})
            else:
                typed = _typed(text, name, self.classes[name], what, value)
                machines[name] = replace(planned, variables={**planned.variables, what: typed})
        self.plan = replace(self.plan, machines=tuple(machines.values()))


class _MachineFinder:
    """Find the machines that code loads by name: those of the plan, and bundles beside them."""

    def __init__(self, classes: Iterable[type[Machine]], folders: Iterable[Path]):
        self._classes = {cls.__name__: cls for cls in classes}
        self._folders = (Path(), *folders)

    def __call__(self, name: str) -> type[Machine] | None:
        """Return the machine class of that name, or None."""
        if name in self._classes:
            return self._classes[name]
        try:
            return find_machine_class(name, self._folders)
        except click.UsageError:
            return None  # the arrangement's error names the machines that can be loaded


def parse_arguments(
    arguments: Iterable[str],
    table: Path | None,
    suspended: Iterable[str],
    preloaded: Iterable[str],
) -> ResolvedPlan:
    """Return the plan of the arguments of ``llfsm run``; raise ``click.UsageError``."""
    sets = [text for text in arguments if ":" in text.partition("=")[0] and "=" in text]
    machines = [text for text in arguments if text not in sets]
    files = [Path(text) for text in machines if text.endswith(_FILE)]
    if table is not None:
        files.append(table)
    if len(files) > 1 or (files and len(machines) > (table is None)):
        raise click.UsageError("name one arrangement file or one dispatch table, without machines")
    more = [PlannedMachine(definition=text, suspended=True) for text in suspended]
    more += [PlannedMachine(definition=text, preload=True) for text in preloaded]
    if files:
        file = files[0]
        folders = [file.absolute().parent, Path()]
        if file.suffix == _FILE:
            plan = read_plan(file)
        else:
            plan = read_dispatch_table(file)
            folders.reverse()  # as in clfsm, paths are relative to the current folder
    else:
        plan = Plan(machines=tuple(_named(text) for text in machines))
        folders = [Path()]
    plan = replace(plan, machines=(*plan.machines, *more))
    if all(planned.preload for planned in plan.machines):
        only = f"; {sets[0]!r} sets a variable or a slot of one" if sets else ""
        raise click.UsageError(f"name a machine to run{only}; `llfsm run --help` shows examples")
    resolved = ResolvedPlan(plan, folders, f"{files[0]}: " if files else "")
    resolved.set(sets)
    return resolved


def _named(text: str) -> PlannedMachine:
    """Read ``definition`` or ``name=definition``."""
    name, equals, definition = text.partition("=")
    if not equals:
        return PlannedMachine(definition=text)
    return PlannedMachine(definition=definition, name=name)


def _find(planned: PlannedMachine, folders: Sequence[Path], source: str) -> type[Machine]:
    """Return the class of a machine; `source` is the file that names it, "" for an argument."""
    try:
        return find_machine_class(planned.definition, folders)
    except click.UsageError as error:
        why = f"{source}{error.message}"
        if planned.name is not None and not source:
            why = f"{planned.name}={planned.definition}: {why}"
            why += "; a variable is set by name:variable=value"
        raise click.UsageError(why) from error


def _slot(text: str, name: str, cls: type[Machine], slot: str) -> str:
    known = cls.table.slots
    if slot not in known:
        names = ", ".join(known) or "none"
        raise click.UsageError(
            f"{text!r}: {name} uses no slot {slot!r}; it uses: {names}{did_you_mean(slot, known)}"
        )
    return slot


def _typed(text: str, name: str, cls: type[Machine], variable: str, value: str) -> Any:
    known = cls.table.variables
    if variable not in known:
        names = ", ".join(known) or "none"
        raise click.UsageError(
            f"{text!r}: {name} has no variable {variable!r}; it has: {names}"
            f"{did_you_mean(variable, known)}"
        )
    try:
        return msgspec.convert(value, known[variable].type, strict=False)
    except msgspec.ValidationError as error:
        raise click.UsageError(f"{text!r}: {error}") from error
