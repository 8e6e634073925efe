"""Machine classes, read in processes of their own: each has the newest text of the class.

A module is imported once in a process, so a class whose file has changed is loaded by a new one.
What is returned are texts, which need no code of the class. No bundle need be possible of it.
"""

from __future__ import annotations

import importlib
import json
import sys
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from llfsm.errors import LlfsmError
from llfsm.runtime.bundles import load_bundle
from llfsm.runtime.bundles.model import CLASS, Bundle, BundleState, BundleTransition, Fragment
from llfsm.runtime.checking import Finding, check_class, requests_of
from llfsm.runtime.converting._convert import write_converted
from llfsm.runtime.drawing.arrange import MachineLinks, links_of
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.ports import Actuator, Sensor
from llfsm.runtime.engine.source_text import body_of
from llfsm.runtime.engine.table import Table
from llfsm.runtime.plans import PlannedMachine
from llfsm.runtime.worker import Worker, WorkerError


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
            final=state.final,
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


_PATIENCE_S: Final = 30.0  # for the imports of the module, too


class ClassName(NamedTuple):
    """The names of a machine class: its module's file, and how Python imports it."""

    file: Path
    module: str
    name: str

    @property
    def arguments(self) -> list[str]:
        """The arguments for `load_machine`, in a process that imports as this one does."""
        return [str(self.file), self.module, self.name, json.dumps(sys.path)]


class ClassText(NamedTuple):
    """A class as an editor shows it: its texts, and the findings of `llfsm check`."""

    bundle: Bundle
    findings: list[Finding]


def read_class(machine: ClassName) -> ClassText:
    """Read the class as its file has it now; raise `BundleError` if it cannot be imported."""
    text: ClassText = _asked(machine.arguments, "text")
    return text


def convert_class(machine: ClassName) -> Path:
    """Make a bundle of the class, beside its file; raise `BundleError` if that cannot be done."""
    folder: Path = _asked(machine.arguments, "convert")
    return folder


def read_links(found_by: Sequence[str], planned: PlannedMachine) -> MachineLinks:
    """Return the slots and requests that join a machine with others; raise `BundleError`.

    `found_by` are arguments for `load_machine`.
    """
    links: MachineLinks = _asked(found_by, "links", planned)
    return links


def _asked(found_by: Sequence[str], name: str, *arguments: Any) -> Any:
    """Call a method of `_Loaded` in a new process, of the machine that is found there."""
    file = Path(found_by[0])
    try:
        with Worker(f"importing {file.stem}") as worker:
            worker.make(_Loaded, found_by, patience_s=_PATIENCE_S)
            return worker.call(name, *arguments, patience_s=_PATIENCE_S)
    except WorkerError as error:
        raise BundleError(str(error), file) from error
    except LlfsmError as error:
        raise BundleError(str(error)) from error


class _Loaded:
    """The class in the process that has loaded it."""

    def __init__(self, found_by: Sequence[str]):
        self._file = Path(found_by[0])
        self._class = load_machine(found_by)

    def text(self) -> ClassText:
        return ClassText(class_outline(self._class), check_class(self._class))

    def convert(self) -> Path:
        return write_converted(self._class, self._file.parent)

    def links(self, planned: PlannedMachine) -> MachineLinks:
        requests = requests_of(self._class, planned.variables)
        return links_of(self._class, planned.slots, requests)


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
