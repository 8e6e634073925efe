"""The imports that a bundle needs for the names that a class's code takes from its module."""

from __future__ import annotations

import ast
import builtins
import importlib.util
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ..engine.errors import BundleError
from ..engine.source_text import parse_file

__all__ = ["Imports"]


class Imports:
    """Names of modules, each of which is imported as its module does, or from its module."""

    def __init__(self) -> None:
        self._lines: dict[str, tuple[str, str]] = {}  # the line of each name, and its module

    def need(self, name: str, module: Mapping[str, Any], file: Path, line: int) -> None:
        """Import `name` as code of `module` does; raise `BundleError` if that cannot be done."""
        if name not in module:
            if hasattr(builtins, name):
                return
            what = f"nothing is called {name!r} when it runs; is it imported for type checkers only"
            raise BundleError(f"cannot be made a bundle: {what}?", file, line)
        home = str(module["__name__"])
        if self._lines.get(name, ("", home))[1] == home:
            if name not in self._lines:
                self._lines[name] = _import_of(name, module, file, line), home
            return
        written = _import_of(name, module, file, line)
        other, where = self._lines[name]
        if other != written:
            raise BundleError(
                f"cannot be made a bundle: {name!r} is of {home} here, and of {where} elsewhere; "
                f"rename one of them",
                file,
                line,
            )

    @property
    def names(self) -> set[str]:
        """The names that are imported."""
        return {*self._lines}

    @property
    def text(self) -> str:
        """The statements, those from one module in one."""
        plain = sorted({line for line, _ in self._lines.values() if "\n" not in line})
        by_module: dict[str, list[str]] = {}
        for line in {line for line, _ in self._lines.values() if "\n" in line}:
            module, name = line.split("\n")
            by_module.setdefault(module, []).append(name)
        several = [
            _from(module, sorted(names, key=_as_sorted)) for module, names in by_module.items()
        ]
        return "".join(f"{line}\n" for line in (*plain, *sorted(several)))


def _from(module: str, names: list[str]) -> str:
    line = f"from {module} import {', '.join(names)}"
    if len(line) <= 100:
        return line
    return f"from {module} import (\n" + "".join(f"    {name},\n" for name in names) + ")"


def _as_sorted(name: str) -> tuple[bool, bool, str]:
    """Order names as import sorters do: constants, classes, the rest."""
    return not name.isupper(), not name[:1].isupper(), name


def _import_of(name: str, module: Mapping[str, Any], file: Path, line: int) -> str:
    """Return how to import a name: a line, or the module and the name on two."""
    parsed = parse_file(str(module.get("__file__", "")))
    for node in reversed(parsed[1].body if parsed else []):
        for alias in node.names if isinstance(node, ast.Import | ast.ImportFrom) else ():
            if (alias.asname or alias.name.partition(".")[0]) != name:
                continue
            called = alias.name if alias.asname is None else f"{alias.name} as {alias.asname}"
            if isinstance(node, ast.Import):
                return f"import {called}"
            assert isinstance(node, ast.ImportFrom)
            source = "." * node.level + (node.module or "")
            home = importlib.util.resolve_name(source, str(module.get("__package__") or ""))
            if home != "__future__":
                return f"{home}\n{called}"
        if name in _bound_by(node):
            break
    home = str(module["__name__"])
    if getattr(sys.modules.get(home), name, None) is not module[name] or home == "__main__":
        raise BundleError(
            f"cannot be made a bundle: {name!r} is of {home}, which cannot be imported; "
            f"put it into a module of its own",
            file,
            line,
        )
    return f"{home}\n{name}"


def _bound_by(node: ast.stmt) -> Iterator[str]:
    for each in ast.walk(node):
        if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store):
            yield each.id
        elif isinstance(each, ast.FunctionDef | ast.ClassDef):
            yield each.name
