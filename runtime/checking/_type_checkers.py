"""Findings of mypy or pyright, whichever is installed, about the code of machines.

The module of a class is checked as it is. A Python bundle is written as one module, which is never
run, with a class whose methods are its texts. Its tree is made of the bundle's own nodes, so that
whatever a type checker finds in it has a place in the bundle (`BundleModule.places`).
"""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import site
import subprocess
import sys
import sysconfig
import tempfile
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from llfsm import errors
from llfsm.runtime.bundles import Bundle, BundleState, Fragment, read_bundle, require_python
from llfsm.runtime.bundles.code import label_of, parse, parse_expression
from llfsm.runtime.bundles.compiling import Scope
from llfsm.runtime.bundles.names import Known, resolve, resolve_method
from llfsm.runtime.checking._subject import Finding, Place, Severity
from llfsm.runtime.engine.errors import BundleError, TypeCheckerError
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.expressions.reads import MACHINE


class BundleModule(NamedTuple):
    """The text of a module, and the places in a bundle of what begins at its lines and columns."""

    text: str
    places: Sequence[tuple[tuple[int, int], Place]]

    def place(self, line: int, column: int) -> Place:
        """Find the place in the bundle of a line (from 1) and column (from 0) of the text."""
        after = bisect_right(self.places, (line, column), key=lambda each: each[0])
        return self.places[max(after, 1) - 1][1]


def module_of(bundle: Bundle) -> BundleModule:
    """Write a Python bundle as a module. Raise `BundleError` where its text is wrong."""
    require_python(bundle)
    made = _Module()
    scope = _WrittenScope(made)
    scope.declare(bundle)
    for state in bundle.states:
        made.add_state(state, scope)
    return made.written(bundle.name)


class _Everything(dict[str, Any]):
    """The names of a module that has every name: the type checker looks for them."""

    def __contains__(self, name: object) -> bool:
        return True


class _Module:
    """A module under way: its includes, the body of its class, and where all of it is from."""

    def __init__(self) -> None:
        self.includes: list[ast.stmt] = []
        self.body: list[ast.stmt] = []
        self.places: dict[ast.AST, Place] = {}

    def add_state(self, state: BundleState, within: _WrittenScope) -> None:
        scope = _WrittenScope(self, within, f"{state.name}.")
        scope.declare(state)
        for section, fragment in state.sections.items():
            tree = resolve(parse(fragment), fragment, scope.known, running=True)
            if tree.body:
                self.add_method(scope.prefix + section, tree.body, "None", fragment)
        for number, each in enumerate(state.transitions):
            if each.expression is not None and label_of(each.expression) != "true":
                value = parse_expression(each.expression)
                value = resolve(value, each.expression, scope.known, running=True)
                body: list[ast.stmt] = [ast.copy_location(ast.Return(value), value)]
                name = f"{scope.prefix}Transition_{number}"
                self.add_method(name, body, "bool", each.expression)

    def add_method(self, name: str, body: list[ast.stmt], result: str, fragment: Fragment) -> None:
        made = ast.parse(f"def method(self) -> {result}: ...").body[0]
        assert isinstance(made, ast.FunctionDef)
        made.name, made.args.args[0].arg, made.body = name, MACHINE, body
        self.add(self.body, made, fragment)

    def add(self, to: list[ast.stmt], node: ast.stmt, fragment: Fragment) -> None:
        to.append(node)
        for each in ast.walk(node):
            if isinstance(each, ast.stmt | ast.expr):
                self.places[each] = Place(fragment.source, each.lineno)

    def written(self, name: str) -> BundleModule:
        head, machine = ast.parse(
            f"import llfsm.runtime\nclass {name}(llfsm.runtime.Machine):\n  pass"
        ).body
        assert isinstance(machine, ast.ClassDef)
        machine.body = self.body or machine.body
        self.includes.sort(key=lambda each: getattr(each, "module", "") != "__future__")
        module = ast.Module([*self.includes, head, machine], [])
        taken = {getattr(each, "id", getattr(each, "arg", "")) for each in ast.walk(module)}
        tree = _Nameable(taken).visit(module)
        text = ast.unparse(ast.fix_missing_locations(tree))
        places: dict[tuple[int, int], Place] = {}
        for before, after in _pairs(tree, ast.parse(text)):
            if before in self.places and isinstance(after, ast.stmt | ast.expr):
                places.setdefault((after.lineno, after.col_offset), self.places[before])
        return BundleModule(text, sorted(places.items()))


class _WrittenScope(Scope):
    """A scope whose declarations are written into a module."""

    def __init__(self, made: _Module, within: Scope | None = None, prefix: str = ""):
        super().__init__((), within=within, prefix=prefix)
        self.made = made

    @property
    def known(self) -> Known:
        return Known(self.names, _Everything())

    def include(self, fragment: Fragment) -> set[str]:
        for node in self.statements(fragment):
            self.made.add(self.made.includes, node, fragment)
        return set()

    def variable(self, name: str, node: ast.AnnAssign, fragment: Fragment) -> None:
        for each in ast.walk(node):
            if isinstance(each, ast.Name) and each.id in self.names:
                each.id = self.names[each.id].attribute
        node.target = ast.copy_location(ast.Name(self.prefix + name, ast.Store()), node.target)
        self.made.add(self.made.body, node, fragment)

    def port(self, name: str, node: ast.Assign, fragment: Fragment) -> str:
        self.made.add(self.made.body, node, fragment)
        return "a port"

    def function(self, node: ast.FunctionDef, fragment: Fragment) -> None:
        resolve_method(node, fragment, self.known)
        (node.args.posonlyargs or node.args.args).insert(0, ast.arg(MACHINE))
        node.name = self.prefix + node.name
        self.made.add(self.made.body, node, fragment)


class _Nameable(ast.NodeTransformer):
    """Rename what the runtime calls by a name that Python does not allow, as ``A.count``."""

    def __init__(self, taken: set[str]):
        self._machine = "self"
        while self._machine in taken:
            self._machine += "_"

    def visit_Name(self, node: ast.Name) -> ast.Name:
        node.id = self._machine if node.id == MACHINE else _identifier(node.id)
        return node

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.arg = self._machine if node.arg == MACHINE else node.arg
        return self.generic_visit(node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        node.attr = _identifier(node.attr)
        return self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.name = _identifier(node.name)
        return self.generic_visit(node)


def _identifier(name: str) -> str:
    return name.replace(".", "__")


def _pairs(one: ast.AST, other: ast.AST) -> Iterator[tuple[ast.AST, ast.AST]]:
    """Pair the nodes of two trees that correspond, those outside before those inside."""
    yield one, other
    for pair in zip(ast.iter_child_nodes(one), ast.iter_child_nodes(other), strict=False):
        if type(pair[0]) is type(pair[1]):
            yield from _pairs(*pair)


_PLUGIN = Path(errors.__file__).with_name("mypy_plugin.py")
_MYPY_LINE = re.compile(r"(.+?):(\d+):(?:(\d+):)? (error|warning): (.*)")
_IGNORED = re.compile(r"#\s*(type|pyright)\s*:\s*ignore")
_MYPY_OPTIONS = (
    "--show-column-numbers", "--show-absolute-path", "--no-pretty", "--no-color-output",
    "--no-error-summary", "--hide-error-context", "--follow-imports=silent",
)  # fmt: skip


_Report: TypeAlias = tuple[Finding, int]
"""A finding as a type checker has it, and its column, from 0."""


def check_types(machines: Iterable[Path | type[Machine]]) -> list[Finding]:
    """Check machines, classes and folders of bundles, with mypy or else pyright.

    mypy uses its configuration in the current folder; without one it has the options
    ``check_untyped_defs`` and the plugin ``llfsm.mypy_plugin``. A line of a bundle that says
    ``# type: ignore`` has no findings. A bundle that cannot be read is left out: `check_bundle`
    finds why. Raise `TypeCheckerError` if no type checker is installed or it does not work.
    """
    with tempfile.TemporaryDirectory(prefix="llfsm-types-") as folder:
        made: dict[str, BundleModule] = {}
        files: dict[str, str] = {}
        for machine in machines:
            if not isinstance(machine, Path):
                files[machine.__module__] = sys.modules[machine.__module__].__file__ or ""
                continue
            module = f"{machine.stem}_machine_{len(made)}"
            with suppress(BundleError):
                made[module] = module_of(read_bundle(machine))
                file = Path(folder, f"{module}.py")
                file.write_text(made[module].text, "utf-8")
                files[module] = str(file)
        reports = [*_reports(files, folder)] if files else []
    return sorted({each for report in reports for each in _finding(report, made)})


def _finding(report: _Report, made: Mapping[str, BundleModule]) -> Iterator[Finding]:
    """Make a report a finding where the user wrote the code."""
    found, column = report
    module = made.get(Path(found.file).stem)  # mypy may name the file of its last run
    if module is None:
        yield found
        return
    place = module.place(found.line, column)
    if not _IGNORED.search(_line_of(place)):
        yield Finding(*place, found.severity, found.text)


def _line_of(place: Place) -> str:
    lines = Path(place.file).read_text("utf-8-sig").splitlines()
    return lines[place.line - 1] if place.line <= len(lines) else ""


def _reports(files: Mapping[str, str], folder: str) -> Iterator[_Report]:
    """Run a type checker on modules, by name, and their files; `folder` is for its own files."""
    environment = dict(os.environ)
    search = _search_path(folder)
    if mypy := _program("mypy"):
        environment["MYPYPATH"] = os.pathsep.join(search)
        settings = [] if _is_configured() else [f"--config-file={_settings(folder)}"]
        modules = [part for module in files for part in ("-m", module)]
        interpreter = f"--python-executable={sys.executable}"
        command = [mypy, *_MYPY_OPTIONS, *settings, interpreter, *modules]
        return _read_mypy(_output(command, environment))
    if pyright := _program("pyright"):
        environment["PYTHONPATH"] = os.pathsep.join(search)
        command = [pyright, "--outputjson", f"--pythonpath={sys.executable}", *files.values()]
        return _read_pyright(_output(command, environment))
    raise TypeCheckerError(
        "no type checker is installed: install mypy or pyright, as by `pip install mypy`"
    )


def _program(name: str) -> str | None:
    """Find a program that belongs to this Python, or else is in the search path."""
    beside = os.path.dirname(sys.executable)
    return shutil.which(name, path=os.pathsep.join([beside, os.environ.get("PATH", "")]))


def _search_path(folder: str) -> list[str]:
    """List the folders in which imports of machines are found, but for what is installed."""
    installed = [
        *sysconfig.get_paths().values(),
        *site.getsitepackages(),
        site.getusersitepackages(),
    ]
    own = [each for each in sys.path if each and not each.startswith(tuple(installed))]
    return [folder, *own]


def _is_configured() -> bool:
    """Check if mypy finds a configuration of the user's project."""
    here = Path.cwd()
    for each in (here, *here.parents):
        sections = {"pyproject.toml": "[tool.mypy]", "setup.cfg": "[mypy]"}
        found = [each / name for name in ("mypy.ini", ".mypy.ini")]
        found += [
            each / name
            for name, section in sections.items()
            if (each / name).is_file() and section in (each / name).read_text("utf-8", "replace")
        ]
        if any(file.is_file() for file in found):
            return True
        if (each / ".git").exists():
            break
    return False


def _settings(folder: str) -> str:
    """Write what mypy is to do where the user's project does not say, and return the file."""
    file = Path(folder) / "mypy.ini"
    file.write_text(f"[mypy]\ncheck_untyped_defs = True\nplugins = {_PLUGIN}\n")
    return str(file)


def _output(command: Sequence[str], environment: Mapping[str, str]) -> str:
    """Run a type checker and return its output; raise `TypeCheckerError` if it cannot check."""
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1) and not _MYPY_LINE.search(done.stdout):
        printed = (done.stderr.strip() or done.stdout.strip()).splitlines() or ["nothing"]
        raise TypeCheckerError(
            f"{command[0]} ended with status {done.returncode}: {printed[-1]}; "
            f"run it by itself to see why"
        )
    return done.stdout


def _read_mypy(output: str) -> Iterator[_Report]:
    for line in output.splitlines():
        if found := _MYPY_LINE.fullmatch(line):
            file, number, column, severity, text = found.groups()
            reported: Severity = "error" if severity == "error" else "warning"
            finding = Finding(file, int(number), reported, " ".join(text.split()))
            yield finding, int(column or 1) - 1


def _read_pyright(output: str) -> Iterator[_Report]:
    for each in json.loads(output)["generalDiagnostics"]:
        if each["severity"] in ("error", "warning"):
            start = each.get("range", {}).get("start", {"line": 0, "character": 0})
            text = ": ".join(line.strip() for line in each["message"].splitlines())
            rule = f" [{each['rule']}]" if "rule" in each else ""
            finding = Finding(each["file"], start["line"] + 1, each["severity"], text + rule)
            yield finding, start["character"]
