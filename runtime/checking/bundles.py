"""A Python bundle as a subject of the rules, with the errors in each of its files.

Names are resolved as when it is loaded, but on through all files: a scope claims to have every
name, and remembers those that nothing defines. A bundle without errors is then loaded, so a bundle
without findings is one that loads. Files that look like part of the machine, but that nothing
reads, are found, too.
"""

from __future__ import annotations

import ast
import builtins
import sys
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from llfsm.errors import did_you_mean, nothing_called
from llfsm.runtime.bundles import (
    PYTHON,
    Bundle,
    BundleState,
    BundleTransition,
    Fragment,
    compile_bundle,
)
from llfsm.runtime.bundles.code import parse, parse_expression, parse_run
from llfsm.runtime.bundles.compiling import CONTROLS, ENDS, Scope, require_own_files
from llfsm.runtime.bundles.names import (
    UNTRANSLATED,
    Known,
    included_names,
    is_mark,
    resolve,
    resolve_method,
    untranslated,
)
from llfsm.runtime.bundles.read import (
    DECLARATIONS,
    MARKS,
    PARTS,
    Reader,
    read_bundle,
)
from llfsm.runtime.checking._rules import findings_of
from llfsm.runtime.checking._subject import (
    CheckedState,
    CheckedTransition,
    Declared,
    Finding,
    Place,
    Subject,
)
from llfsm.runtime.checking._typed_rules import typed_findings
from llfsm.runtime.engine.errors import BundleError, DefinitionError, UnreachableStateWarning
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.table import Table
from llfsm.runtime.expressions.reads import MACHINE, Code, parameter_names

_OTHERS = ("IncludePath", "Language", "Layout.plist", "States", "SuspendState")
_OF_TRANSITIONS = (".expr", ".target")


def unread_files(bundle: Bundle, folder: Path) -> Iterator[Finding]:
    """Find the files of a Python bundle that nothing reads, each with the name that was meant.

    Only files named like those of a bundle count: notes and modules may be kept beside them.
    """
    known = {*_OTHERS, *(f"{bundle.name}_{part}.py" for part in DECLARATIONS)}
    for state in bundle.states:
        stem = f"State_{state.name}"
        known |= {f"{stem}_{each}" for each in MARKS}
        known |= {f"{stem}_{part}.py" for part in PARTS}
        for number in range(len(state.transitions) + 1):  # one more: its name may be meant
            known |= {f"{stem}_Transition_{number}{suffix}" for suffix in _OF_TRANSITIONS}
    for file in sorted(folder.iterdir()):
        if file.name not in known and file.is_file() and not file.name.startswith("."):
            near = did_you_mean(file.name, known)
            is_python = file.suffix == ".py" and file.name.startswith(("State_", f"{bundle.name}_"))
            is_part = file.name.endswith(tuple(f"_{part}.py" for part in DECLARATIONS))
            is_named = file.suffix in _OF_TRANSITIONS or (near and not file.suffix)
            if is_python or is_part or is_named:
                if is_part and not file.name.startswith("State_"):
                    part = file.stem.rpartition("_")[2]
                    near = f"; the machine's is {bundle.name}_{part}.py"
                text = f"nothing reads this file{near or ': States lists no such state'}"
                yield Finding(str(file), 1, "warning", text)


_ALWAYS_KNOWN = frozenset(
    (*dir(builtins), *vars(ModuleType("")), "__builtins__", "__class__", "__file__")
)
_KINDS = {"Sensor": "a sensor", "Actuator": "an actuator"}


def check_bundle(folder: Path, *, load: bool = True) -> list[Finding]:
    """Return the findings about the bundle in `folder`. Its sections are read but not run.

    If no error is found, it is loaded, which runs what it includes and the values of its variables;
    not without `load`.
    """
    return _check(folder, load=load)[0]


def load_checked(folder: Path) -> type[Machine]:
    """Return the machine class of the bundle in `folder`; raise `BundleError` at its first error.

    What `check_bundle` only warns of is no error.
    """
    findings, machine = _check(folder, load=True)
    errors = [each for each in findings if each.severity == "error"]
    if errors or machine is None:
        require_own_files(folder.resolve())
        first = errors[0]
        raise BundleError(first.text, Path(first.file), first.line)
    return machine


def _check(folder: Path, *, load: bool) -> tuple[list[Finding], type[Machine] | None]:
    wrong: list[BundleError] = []
    try:
        bundle = _Lenient(folder.resolve(), wrong).bundle()
    except BundleError as error:
        return sorted(_finding(each, folder) for each in (*wrong, error)), None
    findings = [_finding(each, folder) for each in wrong]
    checker = _Checker(bundle) if bundle.language == PYTHON else None
    if checker is not None:
        findings += unread_files(bundle, folder.resolve())
        findings += findings_of(checker.subject())
        findings += checker.findings
    machine = None
    if load and not any(each.severity == "error" for each in findings):
        found, machine = _load(bundle, folder, checker)
        findings += found
    return sorted(set(findings)), machine


def bundle_subject(folder: Path) -> Subject:
    """Return the bundle in `folder` as the rules see it; raise `BundleError`."""
    return _Checker(read_bundle(folder)).subject()


def declared_names(bundle: Bundle) -> dict[str, list[str]]:
    """Return the names that code can use: at "" those of all states, then what each has besides.

    They are those of variables, slots, methods, of what is included and of what every machine has.
    """
    checker = _Checker(bundle)
    machine = checker.scope(bundle, None)
    names = {"": sorted({*machine.names, *_included(bundle)})}
    for state in bundle.states:
        own = {*checker.scope(state, machine).names, *_included(state)}
        names[state.name] = sorted(own.difference(names[""]))
    return names


def _included(source: Bundle | BundleState) -> frozenset[str]:
    """Return the names that includes import or define, as far as they can be known."""
    if source.includes is None:
        return frozenset()
    return included_names(parse(source.includes).body) or frozenset()


class _Lenient(Reader):
    """Read on when a transition leads to no state; the error is added to `wrong`."""

    def __init__(self, folder: Path, wrong: list[BundleError]):
        super().__init__(folder)
        self.wrong = wrong

    def known_state(self, fragment: Fragment, names: list[str]) -> str:
        try:
            return super().known_state(fragment, names)
        except BundleError as error:
            self.wrong.append(error)
            return fragment.text.strip()


def _load(
    bundle: Bundle, folder: Path, checker: _Checker | None
) -> tuple[list[Finding], type[Machine] | None]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnreachableStateWarning)  # there is a rule for it
            machine = compile_bundle(bundle)
    except (BundleError, DefinitionError) as error:
        return [_finding(error, folder)], None
    return [] if checker is None else checker.typed(machine.table), machine


def _finding(error: BundleError | DefinitionError, folder: Path) -> Finding:
    if isinstance(error, BundleError):
        file = error.file or folder
        what = str(error)
        if error.file is not None:
            what = what.removeprefix(str(file)).partition(": ")[2]
        return Finding(str(file), error.line or 1, "error", what)
    return Finding(str(folder / "States"), 1, "error", str(error))


class _Names(dict[str, Any]):
    """The names of a module, which claims to have every other name too, and remembers those."""

    def __init__(self, names: Iterable[str]):
        super().__init__(dict.fromkeys(names))
        self.missing: set[str] = set()

    def __contains__(self, name: object) -> bool:
        if not super().__contains__(name):
            self.missing.add(str(name))
        return True


class _CheckedScope(Scope):
    """A scope whose declarations are only read; errors are added to the findings.

    `included` is what the includes define; `everything` is True if that cannot be determined.
    """

    def __init__(self, checker: _Checker, within: _CheckedScope | None = None, prefix: str = ""):
        super().__init__(set(within.included) if within else set(), within=within, prefix=prefix)
        self.included: set[str]
        self.everything: bool = within is not None and within.everything
        self.module: dict[str, Any] = {}  # once the bundle is loaded
        self.checker = checker

    @property
    def known(self) -> Known:
        """The names that code can use; those of the module that are missing are remembered."""
        return Known(self.names, _Names(_ALWAYS_KNOWN | self.included))

    def wrong(self, error: BundleError) -> None:
        self.checker.add(error)

    def statements(self, fragment: Fragment) -> list[ast.stmt]:
        try:
            return super().statements(fragment)
        except BundleError as error:
            self.wrong(error)
            self.everything = True
            return []

    def include(self, fragment: Fragment) -> set[str]:
        statements = self.statements(fragment)
        for node in statements:
            if is_mark(node):
                self.wrong(untranslated(fragment, node))
        included = included_names(statements)
        self.everything |= included is None
        self.included |= included or set()
        return self.included

    def variable(self, name: str, node: ast.AnnAssign, fragment: Fragment) -> None:
        place = Place(fragment.source, node.lineno)
        self.checker.result.declared[self.prefix + name] = Declared("variable", place)

    def port(self, name: str, node: ast.Assign, fragment: Fragment) -> str:
        result, place = self.checker.result, Place(fragment.source, node.lineno)
        called, options = "", set[str | None]()
        if isinstance(node.value, ast.Call):
            called = ast.unparse(node.value.func).rpartition(".")[2]
            options = {each.arg for each in node.value.keywords}
        if called == "Sensor":
            result.sensors.add(name)
            result.declared[name] = Declared("sensor", place)
        elif called == "Actuator":
            result.actuators.add(name)
            if "at_end" not in options:  # a use
                result.declared[name] = Declared("actuator", place)
        if isinstance(node.value, ast.Constant):
            kind = type(node.value.value).__name__
            text = f"a variable needs a type, as {name}: {kind} = {ast.unparse(node.value)}"
            self.wrong(fragment.error(text, node.lineno))
        return _KINDS.get(called, "a port")

    def function(self, node: ast.FunctionDef, fragment: Fragment) -> None:
        self.checker.method(node, fragment, self)


class _Checker:
    def __init__(self, bundle: Bundle):
        self.bundle = bundle
        self.findings: list[Finding] = []
        self.attributes = {*dir(Machine)}
        self.result = Subject([], bundle.suspend, self.attributes)
        self.scopes: dict[str, _CheckedScope] = {}  # by state; that of the machine is ""

    def typed(self, table: Table) -> list[Finding]:
        """Apply the rules that need types, now that the bundle is loaded."""
        names = vars(sys.modules[table.path])
        self.scopes[""].module.update(names)
        for state in table.states:
            guards = [each.guard for each in state.transitions if each.guard is not None]
            code = next(iter([*state.sections.values(), *guards]), None)
            self.scopes[state.name].module.update(getattr(code, "__globals__", names))
        return typed_findings(self.result, table)

    def subject(self) -> Subject:
        """Make the subject; errors in its names are added to `findings`."""
        bundle = self.bundle
        scope = self.scope(bundle, None)
        states = self.file("States")
        listed = [line.strip() for line in states.read_text("utf-8-sig").splitlines()]
        for state in bundle.states:
            within = self.scope(state, scope)
            sections = {name: self.code(text, within) for name, text in state.sections.items()}
            self.result.sections += [code for code in sections.values() if code]
            for fragment in state.run_texts(bundle.folder):
                self.result.sections += self.given(fragment, within)
            transitions = [
                self.transition(each, within, f"State_{state.name}_Transition_{number}", state)
                for number, each in enumerate(state.transitions)
            ]
            place = Place(str(states), listed.index(state.name) + 1)
            internal = state.sections.get("Internal")
            goes_on = state.final and internal is not None and bool(internal.text.strip())
            on_entry = sections.get("OnEntry")
            checked = CheckedState(state.name, place, transitions, goes_on, on_entry)
            self.result.states.append(checked)
        return self.result

    def file(self, name: str) -> Path:
        return (self.bundle.folder or Path()) / name

    def transition(
        self, source: BundleTransition, scope: _CheckedScope, stem: str, state: BundleState
    ) -> CheckedTransition:
        fragment = source.expression
        if fragment is None:
            place = Place(str(self.file(f"{stem}.target")), 1)
            return CheckedTransition(source.target, place, True)
        place = Place(fragment.source, 1)
        if fragment.text.strip() == "true":
            return CheckedTransition(source.target, place, True)
        if state.runs and fragment.text.strip() in ENDS:
            return CheckedTransition(source.target, place, None)
        guard = self.code(fragment, scope, expression=True)
        return CheckedTransition(source.target, place, guard.truth if guard else None, guard)

    def given(self, fragment: Fragment, scope: _CheckedScope) -> Iterator[Code]:
        """Read the values that a machine gets which a state runs."""
        try:
            name, values = parse_run(fragment)
        except BundleError:  # as which loading reports it
            return
        if values:  # `dict` stands for the machine, which is none of the names of the code
            text = fragment.text.replace(name, "dict", 1)
            if code := self.code(Fragment(text, fragment.file), scope, expression=True):
                yield code

    def scope(self, source: Bundle | BundleState, within: _CheckedScope | None) -> _CheckedScope:
        """Make the scope of the code of `source`."""
        prefix = "" if within is None else f"{source.name}."
        scope = _CheckedScope(self, within, prefix)
        self.scopes["" if within is None else source.name] = scope
        scope.declare(source)
        self.attributes |= {meaning.attribute for meaning in scope.names.values()}
        return scope

    # Code

    def method(self, node: ast.FunctionDef, fragment: Fragment, scope: _CheckedScope) -> None:
        known = scope.known
        self.warn_of_parameters(node, fragment)
        try:
            resolve_method(node, fragment, known)
        except BundleError as error:
            self.add(error)
            return
        self.add_missing(node, fragment, known, scope)
        self.result.methods[scope.prefix + node.name] = Code(
            node.body, MACHINE, fragment.source, scope.module, parameter_names(node.args)
        )

    def code(
        self, fragment: Fragment, scope: _CheckedScope, *, expression: bool = False
    ) -> Code | None:
        """Resolve the names of a text; None if it cannot be read."""
        known = scope.known
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
            return Code(tree.body, MACHINE, fragment.source, scope.module)
        body = [ast.copy_location(ast.Return(tree), tree)]
        return Code(body, MACHINE, fragment.source, scope.module)

    def add_missing(
        self, tree: ast.AST, fragment: Fragment, known: Known, scope: _CheckedScope
    ) -> None:
        """Add a finding for each line that uses a name which nothing defines."""
        assert isinstance(known.module, _Names)
        for node in ast.walk(tree):
            if not isinstance(node, ast.Name) or node.id not in known.module.missing:
                continue
            if node.id == UNTRANSLATED:
                self.add(untranslated(fragment, node))
            elif not scope.everything:
                what = nothing_called(node.id, {*scope.names, *scope.included})
                if node.id in (each.name for each in self.bundle.states):
                    what = f"{node.id!r} is a state: a transition enters it"
                self.add(fragment.error(what, node.lineno))

    def warn_of_parameters(self, tree: ast.AST, fragment: Fragment) -> None:
        for node in ast.walk(tree):
            if isinstance(node, ast.arg) and node.arg in CONTROLS:
                text = f"the parameter {node.arg!r} hides what every machine has"
                self.findings.append(Finding(fragment.source, node.lineno, "warning", text))

    def add(self, error: BundleError) -> None:
        """Add a finding. Code with an error may hide that something is used."""
        self.findings.append(_finding(error, self.file("")))
        self.result.opaque = True
