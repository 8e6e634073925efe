"""Machines as a command line names them: one by its name, several as a plan with their classes.

A name is tried as a bundle in the folders that are searched, then as a machine that ships, then as
a module's file, then as a machine of an installed package, or as an import with the class behind a
colon. Nothing is imported but what is named, as that runs a module's code. What this code raises
becomes a `MachineImportError` with the place in the user's own code, not a traceback through ours.
"""

from __future__ import annotations

import importlib
import re
import sys
import traceback
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import click
import msgspec
from msgspec.structs import replace

import llfsm
from llfsm.errors import LlfsmError, did_you_mean, nearby_file
from llfsm.runtime.bundles import SUFFIX, load_bundle
from llfsm.runtime.engine.machine import Machine, MachineType
from llfsm.runtime.plans import (
    Plan,
    PlannedMachine,
    assemble,
    names_of,
    read_dispatch_table,
    read_plan,
)

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from llfsm.runtime.engine.arrangement import Arrangement
    from llfsm.runtime.engine.environment import Environment

_HERE = (Path(),)
_MOST_NAMED = 8  # machines that ship, in an error
_PYTHON = ".py"
_PLAN = ".toml"
GROUP = "llfsm.machines"
"""The entry points by which installed packages name their machines."""
_NOT_THEIRS = (*llfsm.__path__, "<frozen ", importlib.__file__)


class MachineImportError(LlfsmError):
    """Code of a machine's module raised when it was imported; `__cause__` is what it raised.

    `file` and `line` are the innermost place in code that is not llfsm's.
    """

    def __init__(self, cause: BaseException, file: str, line: int):
        self.problem = f"{type(cause).__name__}: {_text(cause)}"
        self.file = file
        self.line = line
        super().__init__(f"{file}:{line}: {self.problem}")


def _text(error: BaseException) -> str:
    """Return the message of an error without paths, with a suggestion for a wrong name in it."""
    if isinstance(error, SyntaxError):
        return error.msg
    if isinstance(error, AttributeError) and error.name is not None:
        return str(error) + did_you_mean(error.name, dir(error.obj))
    if isinstance(error, ImportError) and error.name in sys.modules:
        text, _, _ = str(error).partition(" (")
        name = text.split("'")[1] if text.startswith("cannot import name '") else ""
        return text + did_you_mean(name, dir(sys.modules[error.name]))
    return str(error)


def find_bundle(name: str, folders: Iterable[Path] = _HERE) -> Path | None:
    """Find a bundle by its path from one of `folders`, with or without ``.machine``."""
    path = Path(name)
    names = (path, path.with_name(path.name + SUFFIX)) if path.name else ()
    for folder in (each.absolute() for each in folders):
        for each in names:
            if each.suffix == SUFFIX and (folder / each).is_dir():
                return folder / each
    return None


def find_machine_class(name: str, folders: Sequence[Path] = _HERE) -> type[Machine]:
    """Find the class of a machine by any of the names that a command takes.

    `name` is one of the machines that ship, one that an installed package names among its entry
    points, a bundle, ``package.module:Class``, or ``folder/module.py:Class``. The class can be left
    out where a module has one machine, and ``.py`` then, too. Bundles and modules are searched in
    `folders`, by default the current one. Raise ``click.UsageError`` if there is no such machine,
    `BundleError` if its bundle is wrong, and `MachineImportError` if its module is.
    """
    search_modules_in(folders)
    bundle = find_bundle(name, folders)
    if bundle is not None:
        return load_bundle(bundle)
    where, colon, attribute = name.partition(":")
    from llfsm import machines as shipped  # here, as it imports all of them

    known = [each for each in shipped.__all__ if isinstance(vars(shipped)[each], MachineType)]
    if not colon and name in known:
        return _machine_in(shipped, name, name)
    if name.isidentifier() and _module_file(name, folders) is None:
        installed = [each for each in _installed() if each.name == name]
        if installed:
            return _installed_machine(name, installed)
    module = _module(where, name, folders, importable=bool(colon or attribute))
    if module is None:
        raise _unknown(name, known, folders)
    return _machine_in(module, attribute, name)


def _installed() -> Iterable[EntryPoint]:
    """Return the machines that installed packages name among their entry points."""
    from importlib.metadata import entry_points  # here, as it costs as much as all else

    return entry_points(group=GROUP)


def _installed_machine(name: str, installed: Sequence[EntryPoint]) -> type[Machine]:
    """Import a machine that an installed package has under that name."""
    if len({entry.value for entry in installed}) > 1:
        there = " or ".join(sorted(entry.value for entry in installed))
        raise click.UsageError(f"{name}: several packages have a machine of that name: {there}")
    entry = installed[0]
    return _machine_in(_import(entry.module, name), entry.attr, name)


def find_object(name: str, folders: Sequence[Path] = _HERE) -> tuple[ModuleType, Any]:
    """Import the module of ``package.module:name`` or ``file.py:name``; return it and that object.

    Without a name, the object is the module. Modules are searched as those of machines, and errors
    are the same.
    """
    search_modules_in(folders)
    where, _, attribute = name.partition(":")
    module = _module(where, name, folders, importable=True)
    if module is None:
        raise click.UsageError(f"{name}: name it as module:name or path/to/module.py:name")
    if attribute and not hasattr(module, attribute):
        near = did_you_mean(attribute, vars(module))
        raise click.UsageError(f"{name}: {module.__name__} has no {attribute!r}{near}")
    return module, getattr(module, attribute) if attribute else module


def _module(
    where: str, name: str, folders: Sequence[Path], *, importable: bool
) -> ModuleType | None:
    """Import the module that `where`, a part of `name`, names by its file or as Python does."""
    file = _module_file(where, folders)
    if file is not None:
        return _import_file(file, name)
    if where.endswith(_PYTHON):
        near = nearby_file(Path(where))
        raise click.UsageError(f"{name}: there is no file {where}{near}")
    if importable and where and all(part.isidentifier() for part in where.split(".")):
        return _import(where, name)
    return None


def _module_file(text: str, folders: Iterable[Path]) -> Path | None:
    """Find the file of a module by its path, with or without ``.py``; None if there is none."""
    for folder in (each.absolute() for each in folders):
        for name in (text, text + _PYTHON):
            if name.endswith(_PYTHON) and (folder / name).is_file():
                return (folder / name).resolve()
    return None


def _machine_in(module: ModuleType, attribute: str, name: str) -> type[Machine]:
    """Return the machine `attribute` of a module, or its only one if none is named."""
    machines = [each for each, value in vars(module).items() if _is_machine(value, module)]
    there = ", ".join(machines) or "none"
    if not attribute and len(machines) == 1:
        attribute = machines[0]
    elif not attribute:
        raise click.UsageError(f"{name}: name one machine, as {name}:CLASS; there are: {there}")
    if not hasattr(module, attribute):
        raise click.UsageError(
            f"{name}: {module.__name__} has no {attribute!r}; its machines: {there}"
            f"{did_you_mean(attribute, machines)}"
        )
    found = getattr(module, attribute)
    if not (isinstance(found, type) and issubclass(found, Machine) and found is not Machine):
        raise click.UsageError(
            f"{name}: {attribute} is not a machine class; {module.__name__} has: {there}"
        )
    return found


def _is_machine(value: object, module: ModuleType) -> bool:
    """Check that `value` is a machine class of `module` itself, not one that it imports."""
    is_machine = isinstance(value, type) and issubclass(value, Machine)
    return is_machine and value.__module__ == module.__name__


def _unknown(name: str, shipped: Sequence[str], folders: Iterable[Path]) -> click.UsageError:
    """Return the error for a machine that is nowhere, with the nearest names that are."""
    files = [found for folder in folders for found in folder.glob("*")]
    modules = [found for found in files if found.suffix == _PYTHON]
    known = {found.stem for found in files if found.suffix in (SUFFIX, _PYTHON)}
    plans = {found.name for found in files if found.suffix == ".toml"}
    if name in plans:
        return click.UsageError(f"{name} is an arrangement file, not a machine: name one of its")
    of_modules = [f"{found.stem}:{name}" for found in modules if _has_class(found, name)]
    near = f"; did you mean {of_modules[0]!r}?" if of_modules else ""
    first = ", ".join(shipped[:_MOST_NAMED])
    more = len(shipped) - _MOST_NAMED
    installed = sorted({entry.name for entry in _installed()})
    others = f"of installed packages: {', '.join(installed[:_MOST_NAMED])};\n" if installed else ""
    return click.UsageError(
        f"no machine {name!r}; those that ship: {first} and {more} more in llfsm.machines;\n"
        f"{others}"
        f"your own: a module, as path/to/module.py:Class, or a bundle, as path/to/Name{SUFFIX}"
        f"{near or did_you_mean(name, {*shipped, *installed, *known, *plans})}"
    )


def _has_class(module: Path, name: str) -> bool:
    """Search the text of a module, which may be no Python, for a class `name`."""
    text = module.read_text(encoding="utf-8", errors="replace")
    return re.search(rf"^class {re.escape(name)}\b", text, re.MULTILINE) is not None


def search_modules_in(folders: Iterable[Path] = _HERE) -> None:
    """Let imports find modules in `folders` first, in this order."""
    for folder in reversed([str(each.absolute()) for each in folders]):
        if folder not in sys.path:
            sys.path.insert(0, folder)


def _import_file(file: Path, name: str) -> ModuleType:
    """Import a file as a module, from the folder that holds its outermost package."""
    root = file.parent
    while (root / "__init__.py").is_file():
        root = root.parent
    parts = file.relative_to(root).with_suffix("").parts
    if not all(part.isidentifier() for part in parts):
        raise click.UsageError(
            f"{name}: {file.stem!r} cannot be imported; a module's name has letters, digits and _"
        )
    search_modules_in([root])
    module = _import(".".join(parts), name)
    if Path(module.__file__ or "").resolve() != file:
        raise click.UsageError(
            f"{name}: another module is called {module.__name__}, too: "
            f"{module.__file__ or 'one of Python'}; rename the file"
        )
    return module


def _import(module: str, name: str) -> ModuleType:
    """Import a module for the machine `name`; its own errors become `MachineImportError`."""
    try:
        return importlib.import_module(module)
    except (Exception, SystemExit) as error:  # of the module's own code, whatever it is
        if isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(f"{error.name}."):
            near = did_you_mean(module, {file.stem for file in Path().glob(f"*{_PYTHON}")})
            raise click.UsageError(f"{name}: there is no module {error.name!r}{near}") from error
        place = _place(error)
        if place is None:
            raise
        raise MachineImportError(error, *place) from error


def _place(error: BaseException) -> tuple[str, int] | None:
    """Return file and line of the innermost code that is not ours where an error was raised."""
    if isinstance(error, SyntaxError) and error.filename is not None:
        return error.filename, error.lineno or 1
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if frame.lineno and not frame.filename.startswith(_NOT_THEIRS):
            return frame.filename, frame.lineno
    return None


class ResolvedPlan:
    """A plan with its machines' `classes` by name, and a `library` for those that they load."""

    def __init__(self, plan: Plan, folders: Sequence[Path], source: str = ""):
        found = [_find(planned, folders, source) for planned in plan.machines]
        names = names_of(plan, [cls.__name__ for cls in found])
        self.classes = dict(zip(names, found, strict=True))
        self.plan = plan
        self.folders = folders
        beside = [Path(cls.table.path) for cls in found]
        bundles = [path.parent for path in beside if path.suffix == SUFFIX]
        self.library = _MachineFinder(self.classes.values(), dict.fromkeys([*folders, *bundles]))

    def assemble(self, environment: Environment, **options: Any) -> Arrangement:
        """Load the machines into an environment, as `assemble` of `llfsm.runtime.plans` does."""
        return assemble(self.plan, self.classes, environment, library=self.library, **options)

    def set(self, texts: Iterable[str]) -> None:
        """Set variables and slots by ``name:variable=value`` and ``name:slot:=other``."""
        machines = dict(zip(self.classes, self.plan.machines, strict=True))
        for text in texts:
            place, _, value = text.partition("=")
            name, _, what = place.partition(":")
            _require(text, name, machines, "no machine", "there are")
            planned, table = machines[name], self.classes[name].table
            if planned.preload:
                raise click.UsageError(
                    f"{text!r}: {name} is only preloaded; the machine that loads it sets that"
                )
            if what.endswith(":"):
                _require(text, what[:-1], table.slots, f"{name} uses no slot", "it uses")
                machines[name] = replace(planned, slots={**planned.slots, what[:-1]: value})
                continue
            _require(text, what, table.variables, f"{name} has no variable", "it has")
            try:
                typed = msgspec.convert(value, table.variables[what].type, strict=False)
            except msgspec.ValidationError as error:
                raise click.UsageError(f"{text!r}: {error}") from error
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
    table: Path | None = None,
    suspended: Iterable[str] = (),
    preloaded: Iterable[str] = (),
) -> ResolvedPlan:
    """Make the plan of the arguments of ``llfsm run``: machines, settings, or a plan's file.

    `table` is the file of a dispatch table; `suspended` and `preloaded` machines are added last.
    Raise ``click.UsageError`` for arguments that name no machine or contradict each other, and
    what `find_machine_class` raises.
    """
    sets = [text for text in arguments if ":" in text.partition("=")[0] and "=" in text]
    machines = [text for text in arguments if text not in sets]
    files = [Path(text) for text in machines if text.endswith(_PLAN)]
    if table is not None:
        files.append(table)
    if len(files) > 1 or (files and len(machines) > (table is None)):
        raise click.UsageError("name one arrangement file or one dispatch table, without machines")
    more = [PlannedMachine(definition=text, suspended=True) for text in suspended]
    more += [PlannedMachine(definition=text, preload=True) for text in preloaded]
    if files:
        file = files[0]
        folders = [file.absolute().parent, Path()]
        if file.suffix == _PLAN:
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
    *names, definition = text.split("=", 1)
    return PlannedMachine(definition=definition, name=names[0] if names else None)


def _find(planned: PlannedMachine, folders: Sequence[Path], source: str) -> type[Machine]:
    """Find the class of a machine; `source` is the file that names it, "" for an argument."""
    try:
        return find_machine_class(planned.definition, folders)
    except click.UsageError as error:
        why = f"{source}{error.message}"
        if planned.name is not None and not source:
            why = f"{planned.name}={planned.definition}: {why}"
            why += "; a variable is set by name:variable=value"
        raise click.UsageError(why) from error


def _require(text: str, wanted: str, known: Iterable[str], what: str, there: str) -> None:
    """Refuse a setting of what is not among those that are `known`."""
    if wanted not in known:
        names = ", ".join(known) or "none"
        raise click.UsageError(
            f"{text!r}: {what} {wanted!r}; {there}: {names}{did_you_mean(wanted, known)}"
        )
