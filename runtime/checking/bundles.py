"""A bundle of Python as a subject, with what is wrong in each of its files.

Its names are resolved as when it is loaded, but on through all files; a bundle in which nothing is
wrong so far is loaded, so that one without findings is one that loads.
"""

from __future__ import annotations

import ast
import builtins
import warnings
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from ..bundles import PYTHON, Bundle, BundleState, BundleTransition, Fragment, compile_bundle
from ..bundles.code import parse, parse_expression
from ..bundles.names import MACHINE, UNTRANSLATED, Known, Meaning, resolve, resolve_method
from ..bundles.read import Reader
from ..bundles.scope import Scope
from ..engine.errors import BundleError, DefinitionError, UnreachableStateWarning
from ..engine.machine import Machine
from .rules import findings_of
from .subject import CheckedState, CheckedTransition, Code, Declared, Finding, Place, Subject

__all__ = ["check_bundle"]

_CONTROLS = Scope({}).names
_ALWAYS_KNOWN = frozenset(
    (*dir(builtins), *vars(ModuleType("")), "__builtins__", "__class__", "__file__")
)
_MARKED = f"C++ that waits to be translated: write the Python, and delete {UNTRANSLATED}"
_KINDS = {"Sensor": "a sensor", "Actuator": "an actuator"}


def check_bundle(folder: Path) -> list[Finding]:
    """Return what is wrong with the bundle in `folder`; its sections are read, never run."""
    wrong: list[BundleError] = []
    try:
        bundle = _Lenient(folder.resolve(), wrong).bundle()
    except BundleError as error:
        return sorted(_finding(each, folder) for each in (*wrong, error))
    findings = [_finding(each, folder) for each in wrong]
    if bundle.language == PYTHON:
        checker = _Checker(bundle)
        findings += findings_of(checker.subject())
        findings += checker.findings
    if not any(each.severity == "error" for each in findings):
        findings += _load(bundle, folder)
    return sorted(set(findings))


class _Lenient(Reader):
    """Read on when a transition leads to no state; what is wrong is added to `wrong`."""

    def __init__(self, folder: Path, wrong: list[BundleError]):
        super().__init__(folder)
        self.wrong = wrong

    def known_state(self, fragment: Fragment, names: list[str]) -> str:
        try:
            return super().known_state(fragment, names)
        except BundleError as error:
            self.wrong.append(error)
            return fragment.text.strip()


def _load(bundle: Bundle, folder: Path) -> list[Finding]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnreachableStateWarning)  # there is a rule for it
            compile_bundle(bundle)
    except (BundleError, DefinitionError) as error:
        return [_finding(error, folder)]
    return []


def _finding(error: BundleError | DefinitionError, folder: Path) -> Finding:
    if isinstance(error, BundleError):
        file = error.file or folder
        what = str(error)
        if error.file is not None:
            what = what.removeprefix(str(file)).partition(": ")[2]
        return Finding(str(file), error.line or 1, "error", what)
    return Finding(str(folder / "States"), 1, "error", str(error))


def _included(statements: list[ast.stmt]) -> frozenset[str] | None:
    """Return the names that statements import or define; None if that cannot be told."""
    names: set[str] = set()
    for node in (node for each in statements for node in ast.walk(each)):
        match node:
            case ast.Import(aliases) | ast.ImportFrom(names=aliases):
                names |= {each.asname or each.name.partition(".")[0] for each in aliases}
            case ast.FunctionDef(name) | ast.AsyncFunctionDef(name) | ast.ClassDef(name):
                names.add(name)
            case ast.Name(name, ast.Store()):
                names.add(name)
    return None if "*" in names else frozenset(names)


class _Names(dict[str, Any]):
    """The names of a module that takes every other name for known, and remembers it."""

    def __init__(self, names: Iterable[str]):
        super().__init__(dict.fromkeys(names))
        self.missing: set[str] = set()

    def __contains__(self, name: object) -> bool:
        if not super().__contains__(name):
            self.missing.add(str(name))
        return True


class _Scope(NamedTuple):
    """What code may name: of its module, None for anything, and of its machine.

    What is declared has `prefix` before its name: a state's own is called ``STATE.name``.
    """

    module: frozenset[str] | None
    names: dict[str, Meaning]
    prefix: str = ""


class _Checker:
    def __init__(self, bundle: Bundle):
        self.bundle = bundle
        self.findings: list[Finding] = []
        self.attributes = {*dir(Machine)}
        self.result = Subject([], bundle.suspend, self.attributes)

    def subject(self) -> Subject:
        """Return the subject; `findings` has then what is wrong with its names."""
        bundle = self.bundle
        scope = self.scope(bundle, _Scope(_ALWAYS_KNOWN, _CONTROLS))
        states = self.file("States")
        listed = [line.strip() for line in states.read_text("utf-8-sig").splitlines()]
        for state in bundle.states:
            within = self.scope(state, scope._replace(prefix=f"{state.name}."))
            for fragment in state.sections.values():
                if code := self.code(fragment, within):
                    self.result.sections.append(code)
            transitions = [
                self.transition(each, within, f"State_{state.name}_Transition_{number}")
                for number, each in enumerate(state.transitions)
            ]
            place = Place(str(states), listed.index(state.name) + 1)
            self.result.states.append(CheckedState(state.name, place, transitions))
        return self.result

    def file(self, name: str) -> Path:
        return (self.bundle.folder or Path()) / name

    def transition(self, source: BundleTransition, scope: _Scope, stem: str) -> CheckedTransition:
        fragment = source.expression
        if fragment is None:
            place = Place(str(self.file(f"{stem}.target")), 1)
            return CheckedTransition(source.target, place, True)
        place = Place(fragment.source, 1)
        if fragment.text.strip() == "true":
            return CheckedTransition(source.target, place, True)
        guard = self.code(fragment, scope, expression=True)
        return CheckedTransition(source.target, place, bool(guard and guard.is_true), guard)

    # What is declared

    def scope(self, source: Bundle | BundleState, outer: _Scope) -> _Scope:
        """Return what the code of `source`, which is within `outer`, may name."""
        nothing = Fragment("")
        includes, variables, methods = (
            each or nothing for each in (source.includes, source.variables, source.methods)
        )
        read = [self.statements(each) for each in (includes, variables, methods)]
        module = outer.module
        if module is not None:
            included = None if None in read else _included(read[0] or [])
            module = None if included is None else module | included
        scope = _Scope(module, dict(outer.names), outer.prefix)
        for node in read[1] or []:
            self.declare(node, variables, scope)
        functions = [each for each in read[2] or [] if isinstance(each, ast.FunctionDef)]
        for function in functions:
            self.name(function.name, "a function of the machine", function, methods, scope)
        for function in functions:  # which may call each other, whatever their order
            self.method(function, methods, scope)
        return scope

    def statements(self, fragment: Fragment) -> list[ast.stmt] | None:
        """Return the statements of a text that declares; None if it cannot be read."""
        try:
            statements = parse(fragment).body
        except BundleError as error:
            self.add(error)
            return None
        for node in statements:
            match node:
                case ast.Expr(ast.Name(name)) if name == UNTRANSLATED:
                    self.add(fragment.error(_MARKED, node.lineno))
        return statements

    def declare(self, node: ast.stmt, fragment: Fragment, scope: _Scope) -> None:
        place = Place(fragment.source, node.lineno)
        match node:
            case ast.AnnAssign(ast.Name(name)):
                self.name(name, "a variable of the machine", node, fragment, scope)
                self.result.declared[scope.prefix + name] = Declared("variable", place)
            case ast.Assign([ast.Name(name)], ast.Call(made) as call):
                called = ast.unparse(made).rpartition(".")[2]
                self.name(name, _KINDS.get(called, "a port"), node, fragment, scope)
                if called == "Sensor":
                    self.result.declared[name] = Declared("sensor", place)
                elif called == "Actuator":
                    self.result.actuators.add(name)
                    if "at_end" not in {each.arg for each in call.keywords}:  # a use
                        self.result.declared[name] = Declared("actuator", place)

    def name(self, name: str, kind: str, node: ast.stmt, fragment: Fragment, scope: _Scope) -> None:
        if name in _CONTROLS:
            what = f"{name!r} would hide what every machine has; rename it"
            self.add(fragment.error(what, node.lineno))
            return
        variable = isinstance(node, ast.AnnAssign)
        scope.names[name] = Meaning(scope.prefix + name, kind, variable)
        self.attributes.add(scope.prefix + name)

    # Code

    def method(self, node: ast.FunctionDef, fragment: Fragment, scope: _Scope) -> None:
        known = Known(scope.names, _Names(scope.module or ()))
        self.warn_of_parameters(node, fragment)
        try:
            resolve_method(node, fragment, known)
        except BundleError as error:
            self.add(error)
            return
        self.add_missing(node, fragment, known, scope)
        self.result.methods[scope.prefix + node.name] = Code(node.body, MACHINE, fragment.source)

    def code(self, fragment: Fragment, scope: _Scope, *, expression: bool = False) -> Code | None:
        """Return a text with its names resolved; None if it cannot be read."""
        known = Known(scope.names, _Names(scope.module or ()))
        tree: ast.Module | ast.expr
        try:
            tree = parse_expression(fragment) if expression else parse(fragment)
            self.warn_of_parameters(tree, fragment)
            tree = resolve(tree, fragment, known, running=True)
        except BundleError as error:
            self.add(error)
            return None
        self.add_missing(tree, fragment, known, scope)
        if isinstance(tree, ast.Module):
            return Code(tree.body, MACHINE, fragment.source)
        return Code([ast.copy_location(ast.Return(tree), tree)], MACHINE, fragment.source)

    def add_missing(self, tree: ast.AST, fragment: Fragment, known: Known, scope: _Scope) -> None:
        """Add a finding for each line that uses a name which nothing defines."""
        assert isinstance(known.module, _Names)
        for node in ast.walk(tree):
            if not isinstance(node, ast.Name) or node.id not in known.module.missing:
                continue
            if node.id == UNTRANSLATED:
                self.add(fragment.error(_MARKED, node.lineno))
            elif scope.module is not None:
                self.add(fragment.error(f"nothing is called {node.id!r}", node.lineno))

    def warn_of_parameters(self, tree: ast.AST, fragment: Fragment) -> None:
        for node in ast.walk(tree):
            if isinstance(node, ast.arg) and node.arg in _CONTROLS:
                text = f"the parameter {node.arg!r} hides what every machine has"
                self.findings.append(Finding(fragment.source, node.lineno, "warning", text))

    def add(self, error: BundleError) -> None:
        """Add a finding; what is wrong may hide that something is used."""
        self.findings.append(_finding(error, self.file("")))
        self.result.opaque = True
