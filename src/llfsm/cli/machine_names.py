"""Machines as a command line names them: ``RosPingPong``, ``package.module:Class``, a bundle."""

from __future__ import annotations

import importlib
import sys
import traceback
from collections.abc import Iterable, Sequence
from pathlib import Path

import click

import llfsm
from llfsm.errors import LlfsmError
from llfsm.runtime.bundles import SUFFIX, load_bundle
from llfsm.runtime.engine.machine import Machine

__all__ = ["MachineImportError", "find_bundle", "find_machine", "search_modules_in"]

_HERE = (Path(),)
_SHIPPED = "llfsm.machines"
_NOT_THEIRS = (*llfsm.__path__, "<frozen ", importlib.__file__)


class MachineImportError(LlfsmError):
    """Code of a machine's module raised when it was imported; `__cause__` is what it raised.

    `file` and `line` are the innermost place in code that is not llfsm's.
    """

    def __init__(self, cause: Exception, file: str, line: int):
        text = cause.msg if isinstance(cause, SyntaxError) else str(cause)
        self.problem = f"{type(cause).__name__}: {text}"
        self.file = file
        self.line = line
        super().__init__(f"{file}:{line}: {self.problem}")


def find_bundle(name: str, folders: Iterable[Path] = _HERE) -> Path | None:
    """Return the folder of the bundle called `name`, with or without ``.machine``, or None.

    `name` is a path from one of `folders`, by default the current one.
    """
    path = Path(name)
    names = (path, path.with_name(path.name + SUFFIX)) if path.name else ()
    for folder in (each.absolute() for each in folders):
        for each in names:
            if each.suffix == SUFFIX and (folder / each).is_dir():
                return folder / each
    return None


def find_machine(name: str, folders: Sequence[Path] = _HERE) -> type[Machine]:
    """Return the class of a bundle, of ``package.module:Class``, or of a machine that ships.

    Bundles and modules are searched in `folders`, by default the current one. Raise
    ``click.UsageError`` if there is no such machine, `BundleError` if its bundle is wrong, and
    `MachineImportError` if its module is.
    """
    search_modules_in(folders)
    bundle = find_bundle(name, folders)
    if bundle is not None:
        return load_bundle(bundle)
    module, colon, attribute = name.partition(":")
    if not colon:
        shipped = importlib.import_module(_SHIPPED)
        if name not in shipped.__all__:
            raise click.UsageError(
                f"no machine {name!r}; those that ship: {', '.join(shipped.__all__)}; "
                f"your own: package.module:Class, or a bundle, as path/to/Name{SUFFIX}"
            )
        module, attribute = _SHIPPED, name
    imported = _import(module, name)
    if not hasattr(imported, attribute):
        raise click.UsageError(f"{name}: {module} has no {attribute!r}")
    found = getattr(imported, attribute)
    if not (isinstance(found, type) and issubclass(found, Machine) and found is not Machine):
        raise click.UsageError(f"{name}: {found!r} is not a machine class")
    return found


def search_modules_in(folders: Iterable[Path] = _HERE) -> None:
    """Let imports find the modules in `folders`, before all others, in this order."""
    for folder in reversed([str(each.absolute()) for each in folders]):
        if folder not in sys.path:
            sys.path.insert(0, folder)


def _import(module: str, name: str) -> object:
    """Return the module of the machine `name`."""
    if not all(part.isidentifier() for part in module.split(".")):
        file = Path(module)
        module = ".".join([*filter(str.isidentifier, file.parent.parts), file.stem])
        raise click.UsageError(
            f"{name}: name a module, not a file: {module}:{name.partition(':')[2]}"
        )
    try:
        return importlib.import_module(module)
    except Exception as error:  # of the module's own code, whatever it is
        if isinstance(error, ModuleNotFoundError) and _is_within(module, error.name):
            raise click.UsageError(f"{name}: there is no module {error.name!r}") from error
        place = _place(error)
        if place is None:
            raise
        raise MachineImportError(error, *place) from error


def _is_within(module: str, package: str | None) -> bool:
    return package is not None and f"{module}.".startswith(f"{package}.")


def _place(error: Exception) -> tuple[str, int] | None:
    """Return the file and line of the code that is not ours where an error was raised."""
    if isinstance(error, SyntaxError) and error.filename is not None:
        return error.filename, error.lineno or 1
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if frame.lineno and not frame.filename.startswith(_NOT_THEIRS):
            return frame.filename, frame.lineno
    return None
