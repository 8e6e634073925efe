"""Machines as a command line names them: ``RosPingPong``, ``package.module:Class``, a bundle."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import click

from llfsm.runtime.bundles import SUFFIX, load_bundle
from llfsm.runtime.engine.machine import Machine

__all__ = ["find_bundle", "find_machine"]

_SHIPPED = "llfsm.machines"


def find_bundle(name: str, folders: Iterable[Path] = (Path(),)) -> Path | None:
    """Return the folder of the bundle that `name` means, with or without ``.machine``, or None.

    It is a path from one of `folders`, by default the current one.
    """
    path = Path(name)
    names = (path, path.with_name(path.name + SUFFIX)) if path.name else ()
    for folder in (each.absolute() for each in folders):
        for each in names:
            if each.suffix == SUFFIX and (folder / each).is_dir():
                return folder / each
    return None


def find_machine(name: str, folders: Sequence[Path] = (Path(),)) -> type[Machine]:
    """Return the machine class of a bundle, of ``package.module:Class``, or one that ships.

    Bundles and modules are looked for in `folders`, by default the current one. Raise
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
        for folder in reversed([str(each.absolute()) for each in folders]):
            if folder not in sys.path:
                sys.path.insert(0, folder)
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
