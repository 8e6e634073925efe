"""The rules for machines together: names that none of them has, slots that two command."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from llfsm.errors import did_you_mean
from llfsm.runtime.bundles import SUFFIX
from llfsm.runtime.checking._classes import class_subject
from llfsm.runtime.checking._subject import Finding, Subject
from llfsm.runtime.checking.bundles import bundle_subject
from llfsm.runtime.debugging.breakpoints import Breakpoint, check_breakpoints
from llfsm.runtime.engine.errors import BreakpointError
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.expressions.reads import CONTROLLING, LOADING, QUESTIONS, Code, nodes_of
from llfsm.runtime.plans import Plan
from llfsm.whiteboard import Slot

_OF_A_MACHINE = CONTROLLING | QUESTIONS


def check_arrangement(
    file: Path,
    plan: Plan,
    classes: Mapping[str, type[Machine]],
    called: Mapping[str, type[Machine]] | None = None,
    *,
    known: Iterable[str] = (),
) -> list[Finding]:
    """Check the machines of an arrangement file together.

    `classes` are the machines' classes by name, in the plan's order; `called` are others that they
    may load, of which there may be breakpoints; `known` are names of machines of other processes.
    Each of them alone is not checked here.
    """
    subjects = {cls: _subject(cls) for cls in classes.values()}
    found = {*_unknown_names([*subjects.values()], {*classes, *known})}
    planned = zip(classes.items(), plan.machines, strict=True)
    commanders = defaultdict(list)
    for (name, cls), machine in planned:
        for slot in {actuator.slot.name for actuator in cls.table.actuators.values()}:
            commanders[machine.slots.get(slot, slot)].append(name)
    for slot, names in commanders.items():
        if len(names) > 1:
            text = f"{' and '.join(names)} post to {slot!r}; is only one of them to run at a time?"
            found.add(Finding(str(file), 1, "warning", text))
    found.update(_misspelt_slots(file, plan, classes))
    slots = {
        machine.slots.get(sensor.slot.name, sensor.slot.name)
        for cls, machine in zip(classes.values(), plan.machines, strict=True)
        for sensor in cls.table.sensors.values()
    }
    for text in plan.breakpoints:
        try:
            check_breakpoints([Breakpoint.parse(text)], {**(called or {}), **classes}, slots)
        except BreakpointError as error:
            found.add(Finding(str(file), 1, "error", str(error)))
    return sorted(found)


def _misspelt_slots(
    file: Path, plan: Plan, classes: Mapping[str, type[Machine]]
) -> Iterator[Finding]:
    """Find slots that one machine posts to and another one reads under nearly the same name."""
    posted: dict[str, tuple[str, Slot[Any]]] = {}
    read: dict[str, tuple[str, Slot[Any]]] = {}
    for (name, cls), machine in zip(classes.items(), plan.machines, strict=True):
        for ports, found in ((cls.table.actuators, posted), (cls.table.sensors, read)):
            for port in ports.values():
                called = machine.slots.get(port.slot.name, port.slot.name)
                found.setdefault(called, (name, port.slot))
    for slot, (reader, wanted) in read.items():
        for other, (poster, given) in posted.items():
            same = wanted.fingerprint == given.fingerprint
            if same and slot not in posted and other not in read and _is_near(slot, other):
                text = f"{reader} reads {slot!r} and {poster} posts to {other!r}: one is misspelt?"
                yield Finding(str(file), 1, "warning", text)


def _is_near(one: str, other: str) -> bool:
    """Check if names differ in one letter, or in upper and lower case."""
    if one.casefold() == other.casefold():
        return True
    short, long = sorted((one, other), key=len)
    pairs = enumerate(zip(short, long, strict=False))
    start = next((place for place, (a, b) in pairs if a != b), len(short))
    if len(long) - len(short) == 1:
        return short[start:] == long[start + 1 :]
    swapped = short[start + 1 : start + 2] + short[start : start + 1] + short[start + 2 :]
    rest = long[start:]
    is_number = long[start : start + 1].isdigit()  # a left and a right one, or so
    same = len(long) == len(short) and not is_number
    return same and (short[start + 1 :] == rest[1:] or swapped == rest)


def requests_of(cls: type[Machine], variables: Mapping[str, Any]) -> list[tuple[str, str]]:
    """List the requests of a machine to machines whose names are in its text, each once.

    A name is a text, or that of a variable at the beginning, which `variables` may give. A question
    is "looks at".
    """
    first = {name: each.default for name, each in cls.table.variables.items()} | {**variables}
    found: dict[tuple[str, str], None] = {}
    for code in _subject(cls).all_code():
        for node in nodes_of(code):
            match node:
                case ast.Call(ast.Attribute(ast.Name(code.machine), what), [argument, *_]):
                    if what not in _OF_A_MACHINE | LOADING:
                        continue
                    name = _text(argument)
                    match argument:
                        case ast.Attribute(ast.Name(code.machine), variable):
                            name = first.get(variable)
                    if isinstance(name, str):
                        found["looks at" if what in QUESTIONS else what, name] = None
    return list(found)


def _subject(cls: type[Machine]) -> Subject:
    folder = Path(cls.table.path)
    is_bundle = folder.suffix == SUFFIX and folder.is_dir()
    return bundle_subject(folder) if is_bundle else class_subject(cls)


def _unknown_names(subjects: list[Subject], known: set[str]) -> Iterator[Finding]:
    """Find requests to machines that the arrangement does not have and that no code loads."""
    requests: list[tuple[Code, ast.Call, str]] = []
    for subject in subjects:
        for code in subject.all_code():
            for node in nodes_of(code):
                match node:
                    case ast.Call(ast.Attribute(ast.Name(code.machine), called), arguments):
                        name = _text(arguments[0]) if arguments else None
                        if called in LOADING:
                            options = {each.arg: each.value for each in node.keywords}
                            loaded = _text(options["name"]) if "name" in options else name
                            if loaded is None:
                                return  # under a name that is not here
                            known.add(loaded)
                        elif called in _OF_A_MACHINE and name is not None:
                            requests.append((code, node, name))
    for code, node, name in requests:
        if name not in known:
            text = f"no machine {name!r} in the arrangement; it has: {', '.join(sorted(known))}"
            yield Finding(code.file, node.lineno, "warning", text + did_you_mean(name, known))


def _text(node: ast.expr) -> str | None:
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else None
