"""Machines as a command line names them: ``RosPingPong``, ``package.module:Class``, a bundle."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click
import msgspec

from ..bundles import SUFFIX, load_bundle
from ..machine import Machine

__all__ = ["find_bundle", "find_machine", "parse_assignments"]

_SHIPPED = "llfsm.machines"


def find_bundle(name: str, folders: Iterable[Path] = ()) -> Path | None:
    """Return the folder of the bundle that `name` means, with or without ``.machine``, or None.

    It is a path from the current folder, or the name of a bundle in one of `folders`.
    """
    path = Path(name)
    names = (path, path.with_name(path.name + SUFFIX)) if path.name else ()
    for folder in (Path.cwd(), *folders):
        for each in names:
            if each.suffix == SUFFIX and (folder / each).is_dir():
                return folder / each
    return None


def find_machine(name: str, folders: Iterable[Path] = ()) -> type[Machine]:
    """Return the machine class of a bundle, of ``package.module:Class``, or one that ships.

    Bundles are looked for as `find_bundle` does, modules also in the current folder. Raise
    ``click.UsageError``, and `BundleError` if a bundle is there but wrong.
    """
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
        found = getattr(shipped, name)
    else:
        here = str(Path.cwd())
        if here not in sys.path:
            sys.path.insert(0, here)
        try:
            found = getattr(importlib.import_module(module), attribute)
        except ModuleNotFoundError as error:
            if error.name is None or not f"{module}.".startswith(f"{error.name}."):
                raise  # found, but something that it imports is not: its own error says what
            raise click.UsageError(f"{name}: there is no module {error.name!r}") from error
        except AttributeError as error:
            raise click.UsageError(f"{name}: {module} has no {attribute!r}") from error
    if not (isinstance(found, type) and issubclass(found, Machine) and found is not Machine):
        raise click.UsageError(f"{name}: {found!r} is no machine class")
    return found


def parse_assignments(
    texts: Iterable[str], machines: dict[str, type[Machine]]
) -> dict[str, dict[str, Any]]:
    """Turn ``name:variable=value`` into the variables of each machine, converted to their types.

    Raise ``click.UsageError`` that says what is wrong with which text.
    """
    assigned: dict[str, dict[str, Any]] = {name: {} for name in machines}
    for text in texts:
        place, _, value = text.partition("=")
        name, colon, variable = place.partition(":")
        if not colon:
            raise click.UsageError(f"{text!r}: variables are set by name:variable=value")
        if name not in machines:
            raise click.UsageError(f"{text!r}: no machine {name!r}; there are: {_list(machines)}")
        known = machines[name].table.variables
        if variable not in known:
            raise click.UsageError(
                f"{text!r}: {name} has no variable {variable!r}; it has: {_list(known)}"
            )
        try:
            assigned[name][variable] = msgspec.convert(value, known[variable].type, strict=False)
        except msgspec.ValidationError as error:
            raise click.UsageError(f"{text!r}: {error}") from error
    return assigned


def _list(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"
