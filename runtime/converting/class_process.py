"""A machine is loaded in a process of its own: its class is always that of the newest text.

The process is asked once, by its arguments, and answers with a JSON object.

A machine class as its texts, to be looked at: also one of which no bundle can be made.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from llfsm.errors import LlfsmError
from llfsm.runtime.bundles import load_bundle
from llfsm.runtime.bundles.model import CLASS, Bundle, BundleState, BundleTransition, Fragment
from llfsm.runtime.checking import Finding
from llfsm.runtime.drawing.arrange import MachineLinks, links_of
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.ports import Actuator, Sensor
from llfsm.runtime.engine.source_text import body_of
from llfsm.runtime.engine.table import Table
from llfsm.runtime.plans import PlannedMachine


def class_outline(cls: type[Machine]) -> Bundle:
    """Return the states, transitions and texts of a class, without a layout."""
    table = cls.table
    states = tuple(
        BundleState(
            state.name,
            {key: Fragment(body_of(code) or repr(code)) for key, code in state.sections.items()},
            tuple(
                BundleTransition(
                    each.target.name, None if each.unconditional else Fragment(each.label)
                )
                for each in state.transitions
            ),
        )
        for state in table.states
    )
    suspend = table.suspend.name if table.suspend else None
    declared = "".join(f"{line}\n" for line in declared_lines(table))
    variables = Fragment(declared) if declared else None
    return Bundle(cls.__name__, states, CLASS, suspend, variables=variables)


def declared_lines(table: Table) -> Iterator[str]:
    """Give a line for each port and variable."""
    yield from (_port(name, port) for name, port in table.sensors.items())
    yield from (_port(name, port) for name, port in table.actuators.items())
    for variable in table.variables.values():
        yield f"{variable.name}: {variable.type_text} = {variable.default!r}"


def _port(name: str, port: Sensor[Any, Any] | Actuator[Any]) -> str:
    slot = port.slot
    return f"{name} = {type(port).__name__}({slot.name!r}, {slot.type.__name__})"


_PATIENCE_S = 30.0  # for the imports of the module, too


class ClassName(NamedTuple):
    """Where a machine class is found: its module's file, and how Python imports it."""

    file: Path
    module: str
    name: str

    @property
    def arguments(self) -> list[str]:
        """The arguments of a process that imports the class."""
        return [str(self.file), self.module, self.name, json.dumps(sys.path)]


class ClassText(msgspec.Struct):
    """What there is to see of a class."""

    bundle: Bundle
    findings: list[Finding]


def read_class(machine: ClassName) -> ClassText:
    """Return the class as its file has it now; raise `BundleError` if it cannot be imported."""
    answer = _asked(["read", *machine.arguments], machine.file)
    return msgspec.convert(answer, ClassText, dec_hook=_path)


def convert_class(machine: ClassName) -> Path:
    """Make a bundle of the class, beside its file; raise `BundleError` if that cannot be done."""
    return Path(_asked(["convert", *machine.arguments], machine.file)["wrote"])


def read_links(found_by: Sequence[str], planned: PlannedMachine) -> MachineLinks:
    """Return what a machine has to do with others, which loads it; raise `BundleError`.

    `found_by` are arguments for `load_machine`.
    """
    as_planned = msgspec.json.encode(planned).decode()
    return MachineLinks(**_asked(["links", as_planned, *found_by], Path(found_by[0])))


def _path(kind: type, value: Any) -> Any:
    return kind(value)


def _asked(arguments: Sequence[str], file: Path) -> Any:
    command = [sys.executable, "-B", "-m", __name__, *arguments]
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            timeout=_PATIENCE_S,
            check=False,
        )
        answer = json.loads(done.stdout)
    except subprocess.TimeoutExpired as error:
        what = f"importing {file.stem} does not return for {_PATIENCE_S:g} s"
        raise BundleError(what, file) from error
    except ValueError as error:
        raise BundleError(f"importing {file.stem} has ended its process", file) from error
    if "problem" in answer:
        raise BundleError(answer["problem"])
    return answer


def _main() -> None:
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the module prints is no answer
    what, *arguments = sys.argv[1:]
    try:
        answer = _answer(what, arguments)
    except LlfsmError as error:
        answer = {"problem": str(error)}
    answers.write(msgspec.json.encode(answer, enc_hook=str))
    answers.flush()


def _answer(what: str, arguments: Sequence[str]) -> Any:
    from llfsm.runtime.checking import check_class, requests_of
    from llfsm.runtime.converting.convert import write_converted

    if what == "links":
        planned = msgspec.json.decode(arguments[0], type=PlannedMachine)
        cls = load_machine(arguments[1:])
        requests = requests_of(cls, planned.variables)
        return links_of(cls, planned.slots, requests)._asdict()
    cls = load_machine(arguments)
    if what == "convert":
        return {"wrote": str(write_converted(cls, Path(arguments[0]).parent))}
    return ClassText(class_outline(cls), check_class(cls))


def load_machine(arguments: Sequence[str]) -> type[Machine]:
    """Return the machine of a bundle's folder, or that of a `ClassName`'s arguments.

    A class must not have been imported in this process yet. Raise `BundleError`.
    """
    where, *names = arguments
    if not names:
        return load_bundle(where)
    module, name, path = names
    sys.path[:] = json.loads(path)
    try:
        found: type[Machine] = getattr(importlib.import_module(module), name)
    except (Exception, SystemExit) as error:  # of the module's own code, whatever it is
        text, line = str(error), _line_in(where, error)
        if isinstance(error, SyntaxError) and error.filename == where:
            text, line = error.msg, error.lineno
        raise BundleError(f"{type(error).__name__}: {text}", Path(where), line) from error
    return found


def _line_in(file: str, error: BaseException) -> int | None:
    """Return the line of a module's file at which the import has failed."""
    frames = traceback.extract_tb(error.__traceback__)
    return next((each.lineno for each in reversed(frames) if each.filename == file), None)


if __name__ == "__main__":
    _main()
