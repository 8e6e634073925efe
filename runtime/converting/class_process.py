"""A machine is loaded in a process of its own: its class is always that of the newest text.

The process is asked once, by its arguments, and answers with a JSON object.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from llfsm.errors import LlfsmError

from ..bundles import Bundle, load_bundle
from ..checking import Finding
from ..drawing.overview import MachineLinks, links_of
from ..engine.errors import BundleError
from ..engine.machine import Machine
from ..plans.plan import PlannedMachine

__all__ = ["ClassName", "ClassText", "convert_class", "load_machine", "read_class", "read_links"]

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
    from ..checking import check_class, requests_of
    from .class_outline import class_outline
    from .convert import write_converted

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
