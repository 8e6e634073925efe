"""Make a machine class from a Python bundle, equal to one written as a class statement.

The includes run first, in a module of the bundle's own. Then the variables, ports and functions are
declared, the machine's before those of its states, which hide them. Only then all names are known,
and sections and guards are compiled with their names resolved (see `names`). A misspelt name is
thus an error when the bundle is loaded, with file and line, and not when a robot first gets there.
Conversion and `llfsm check` apply the same rules (`Scope`) without running anything.

`outline` needs none of this: it makes a table that can be drawn of the texts of any bundle.
"""

from __future__ import annotations

import ast
import os
import shlex
import sys
from abc import ABC, abstractmethod
from collections.abc import Container, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, Self

from llfsm.errors import did_you_mean
from llfsm.runtime.bundles.code import (
    evaluate,
    function_of,
    label_of,
    line_of,
    parse,
    parse_expression,
    parse_run,
    run,
)
from llfsm.runtime.bundles.cpp import without_comments
from llfsm.runtime.bundles.model import PYTHON, Bundle, BundleState, Fragment
from llfsm.runtime.bundles.names import (
    Known,
    Meaning,
    is_mark,
    resolve,
    resolve_method,
    untranslated,
)
from llfsm.runtime.bundles.read import DECLARATIONS, SUFFIX, read_bundle
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.machine import Machine, define
from llfsm.runtime.engine.ports import Actuator, Sensor
from llfsm.runtime.engine.source_text import EXPRESSION, TextOnly
from llfsm.runtime.engine.state import State, Transition
from llfsm.runtime.engine.table import MAY_BE_OWN, REQUIRED, Described, Table
from llfsm.runtime.expressions.reads import MACHINE

CONTROLS = {
    name: Meaning(name, "what every machine has") for name in dir(Machine) if name[0] != "_"
}
"""The names that are known to the code of every machine."""
_ALWAYS = {name: meaning for name, meaning in CONTROLS.items() if name not in MAY_BE_OWN}
ENDS = ("done", "failed", "done or failed", "failed or done")
"""Expressions of states that run machines: the ends of these that a transition waits for."""
_RESERVED = {*dir(Machine), "table"} - MAY_BE_OWN


class Scope(ABC):
    """The names that a machine's code, or that of one of its states, can use.

    This holds the rules of what may be declared, and under which names. A subclass decides what a
    declaration does, and what to do when one is wrong. `prefix` stands before the names that a
    state declares, as in ``A.count``, so that states' names cannot clash.
    """

    def __init__(self, included: Container[str], *, within: Scope | None = None, prefix: str = ""):
        self.included = included
        self.names: dict[str, Meaning] = dict(CONTROLS if within is None else within.names)
        self.prefix = prefix

    # What a subclass does

    def wrong(self, error: BundleError) -> None:
        """Take note of an error; raise it to stop."""
        raise error

    def statements(self, fragment: Fragment) -> list[ast.stmt]:
        """Return the statements of a text that declares, without its docstring."""
        tree = parse(fragment)
        return tree.body[ast.get_docstring(tree, clean=False) is not None :]

    @abstractmethod
    def include(self, fragment: Fragment) -> set[str]:
        """Take over the names of an include and return them."""

    @abstractmethod
    def variable(self, name: str, node: ast.AnnAssign, fragment: Fragment) -> None:
        """Take over a declared variable."""

    @abstractmethod
    def port(self, name: str, node: ast.Assign, fragment: Fragment) -> str:
        """Take over a declared port and return what to call its kind."""

    @abstractmethod
    def function(self, node: ast.FunctionDef, fragment: Fragment) -> None:
        """Take over a function of the machine; all of them have their names by now."""

    # The rules

    def declare(self, source: Bundle | BundleState) -> None:
        """Declare what the includes, variables and methods of `source` declare."""
        if source.includes is not None:
            for name in sorted(self.names.keys() & self.include(source.includes)):
                self.wrong(source.includes.error(
                    f"{name!r} is {self.names[name].kind}; give what is included another name, as "
                    f"by `import ... as`"
                ))  # fmt: skip
        if source.variables is not None:
            for node in self.statements(source.variables):
                self._declare_variable(node, source.variables)
        for state in source.states if isinstance(source, Bundle) else ():
            if state.runs:  # so that code sees what it runs by the state's name
                self.names.setdefault(state.name, Meaning(state.name, "a state that runs machines"))
        if source.methods is not None:
            functions = []
            for node in self.statements(source.methods):
                if isinstance(node, ast.FunctionDef):
                    functions.append(node)
                    if self._is_free(node.name, source.methods, node):
                        attribute = self.prefix + node.name
                        self.names[node.name] = Meaning(attribute, "a function of the machine")
                else:
                    what = "only functions can be declared here; imports belong in the includes"
                    self._refuse(node, source.methods, what)
            for function in functions:  # which may call each other, whatever their order
                self.function(function, source.methods)

    def _declare_variable(self, node: ast.stmt, fragment: Fragment) -> None:
        match node:
            case ast.AnnAssign(ast.Name(name)):
                if self._is_free(name, fragment, node):
                    self.variable(name, node, fragment)
                    attribute = self.prefix + name
                    self.names[name] = Meaning(attribute, "a variable of the machine", True)
            case ast.Assign([ast.Name(name)]) if not self.prefix:
                if self._is_free(name, fragment, node):
                    self.names[name] = Meaning(name, self.port(name, node, fragment))
            case _:
                also = "" if self.prefix else ", name = Sensor(slot) or name = Actuator(slot)"
                what = f"only variables can be declared here, as name: type = value{also}"
                self._refuse(node, fragment, what)

    def _refuse(self, node: ast.stmt, fragment: Fragment, what: str) -> None:
        self.wrong(
            untranslated(fragment, node) if is_mark(node) else fragment.error(what, node.lineno)
        )

    def _is_free(self, name: str, fragment: Fragment, node: ast.stmt) -> bool:
        """Check that a declaration may use `name`: that it would hide nothing from its own code."""
        before = self.names.get(name)
        if name in _RESERVED or name[:2] == "__":
            what = "would hide what every machine has; rename it"
        elif before not in (None, CONTROLS.get(name)) and before.attribute == self.prefix + name:
            what = "is declared twice"
        elif name in self.included:
            what = "is in the includes already; rename it"
        else:
            return True
        self.wrong(fragment.error(f"{name!r} {what}", node.lineno))
        return False


class LoadedScope(Scope):
    """A scope whose declarations are executed.

    `variables` and `attributes` are those of the machine class under way, as `define` takes them.
    """

    def __init__(
        self, module: dict[str, Any], *, within: LoadedScope | None = None, prefix: str = ""
    ):
        super().__init__(module, within=within, prefix=prefix)
        self.module = module
        self.variables: dict[str, tuple[Any, Any]] = {} if within is None else within.variables
        self.attributes: dict[str, Any] = {} if within is None else within.attributes
        self._values: dict[str, Any] = {}  # of the variables so far, which later ones may use

    def of_state(self, state: BundleState) -> Self:
        """Make the scope of a state's code: its declarations hide those of the machine."""
        if not (state.includes or state.variables or state.methods):
            return self
        scope = type(self)(dict(self.module), within=self, prefix=f"{state.name}.")
        scope.declare(state)
        return scope

    @property
    def known(self) -> Known:
        """The meanings of all names in the code."""
        return Known(self.names, self.module)

    def include(self, fragment: Fragment) -> set[str]:
        """Run an include."""
        return {*run(parse(fragment), fragment, self.module)}

    def variable(self, name: str, node: ast.AnnAssign, fragment: Fragment) -> None:
        """Evaluate a variable's type and value."""
        values = self._resolved(node, fragment)
        if node.value is None and self.prefix:
            raise fragment.error(f"{name!r} needs a value, as {name}: int = 0", node.lineno)
        default = REQUIRED if node.value is None else evaluate(node.value, fragment, values)
        annotation = evaluate(node.annotation, fragment, values)
        self.variables[self.prefix + name] = annotation, default
        self._values[name] = default.default if isinstance(default, Described) else default

    def port(self, name: str, node: ast.Assign, fragment: Fragment) -> str:
        """Make a port."""
        port = evaluate(node.value, fragment, self._resolved(node, fragment))
        if not isinstance(port, Sensor | Actuator):
            raise fragment.error(
                f"{name!r} is not a Sensor or an Actuator; a variable needs a type, as "
                f"{name}: {type(port).__name__} = {ast.unparse(node.value)}",
                node.lineno,
            )
        self.attributes[name] = self._values[name] = port
        return "a sensor" if isinstance(port, Sensor) else "an actuator"

    def function(self, node: ast.FunctionDef, fragment: Fragment) -> None:
        """Make a method, with a hidden parameter for its machine."""
        resolve_method(node, fragment, self.known)
        (node.args.posonlyargs or node.args.args).insert(0, ast.arg(MACHINE))
        made = run(ast.Module([node], []), fragment, self.module, {})
        self.attributes[self.prefix + node.name] = made[node.name]

    def _resolved(self, node: ast.stmt, fragment: Fragment) -> dict[str, Any]:
        """Return the values that a declaration may name; raise `BundleError` if it names others."""
        values = self.module | self._values
        resolve(node, fragment, Known(_ALWAYS, values), running=False)
        return values


def load_bundle(folder: str | Path) -> type[Machine]:
    """Load the Python bundle in `folder` as a machine class; its includes are run.

    Its `table.path` is the real path of the folder, its `table.layout` is read from
    ``Layout.plist``. Raise `BundleError`, with file and line, for text that cannot be read or
    understood, and `DefinitionError` for an inconsistent table.
    """
    bundle = read_bundle(folder)
    try:
        return compile_bundle(bundle)
    except BundleError:
        if bundle.folder is not None:
            require_own_files(bundle.folder)
        raise


def compile_bundle(bundle: Bundle) -> type[Machine]:
    """Make the machine class that `bundle` describes; raise as `load_bundle` does."""
    require_python(bundle)
    path = bundle.path
    module = ModuleType(path)
    module.__file__ = path
    sys.modules[path] = module  # where message types defined in it look up their annotations
    _extend_search(bundle)
    scope = LoadedScope(vars(module))
    scope.declare(bundle)
    scopes = {each.name: scope.of_state(each) for each in bundle.states}
    states = _states(bundle, scopes)
    for each in bundle.states:
        _fill(states[each.name], each, states, scopes[each.name])
    cls = define(
        bundle.name,
        states.values(),
        variables=scope.variables,
        attributes={
            "__module__": path,
            "__doc__": module.__doc__,
            **{name: state for name, state in states.items() if state.runs},
            **scope.attributes,
        },
        path=path,
    )
    cls.table.layout = bundle.layout
    return cls


def _states(bundle: Bundle, scopes: Mapping[str, LoadedScope] | None) -> dict[str, State]:
    """Make the states of a bundle; in `scopes`, load what they run, if it is beside this one."""
    states: dict[str, State] = {}
    for each in bundle.states:
        runs: Any = [*each.runs]
        if scopes is not None:
            texts = each.run_texts(bundle.folder)
            runs = [_run_by(bundle, text, scopes[each.name]) for text in texts]
        what: Any = (runs if len(runs) > 1 else runs[0]) if runs else None
        states[each.name] = State(
            each.name,
            suspend=each.name == bundle.suspend,
            final=each.final,
            runs=what,
            history=each.history,
            resume="in_place" if each.in_place else "again",
            clock="stops" if each.clock_stops else "runs",
        )
    return states


_LOADING: list[str] = []  # the bundles under way, of which each runs the next


def _run_by(bundle: Bundle, fragment: Fragment, scope: LoadedScope) -> Any:
    """Find what a state runs: a class, a name or, with values, a function that makes a machine."""
    name, values = parse_run(fragment)
    found: Any = _beside(bundle, name)
    if "(" not in fragment.text:
        return found
    found = scope.module.get(name) if isinstance(found, str) else found
    if not (isinstance(found, type) and issubclass(found, Machine)):
        raise fragment.error(
            f"{name!r} is neither a bundle beside this one nor a class that is included: only "
            f"these can be given values",
            line_of(fragment),
        )
    known = found.table.variables
    for each in values:
        if each.arg not in known:
            what = f"{name} has no variable {each.arg!r}{did_you_mean(str(each.arg), known)}"
            raise fragment.error(what, each.value.lineno)
    hidden = f"<{name}>"  # no text can name it
    scope.module[hidden] = found
    given = [
        ast.keyword(each.arg, resolve(each.value, fragment, scope.known, running=True))
        for each in values
    ]
    made = ast.Call(ast.Name(hidden, ast.Load()), [], given)
    body: list[ast.stmt] = [ast.Return(made, lineno=1, col_offset=0)]
    return function_of("runs", body, fragment, scope.module)


def _beside(bundle: Bundle, name: str) -> type[Machine] | str:
    """Load a bundle beside this one; leave another name for the library of the arrangement."""
    folder = None if bundle.folder is None else bundle.folder.parent / f"{name}{SUFFIX}"
    if folder is None or not folder.is_dir():
        return name
    if bundle.path in _LOADING:
        chain = [Path(each).stem for each in _LOADING[_LOADING.index(bundle.path) :]]
        raise BundleError(f"bundles run each other: {', '.join(chain)}, {bundle.name}", folder)
    _LOADING.append(bundle.path)
    try:
        return load_bundle(folder)
    finally:
        _LOADING.pop()


def outline_beside(bundle: Bundle, name: str) -> Table | None:
    """Make the table of a bundle beside this one, as `outline` does; None if there is none.

    Values that it gets do not matter.
    """
    called = f"{name.partition('(')[0]}{SUFFIX}"
    folder = None if bundle.folder is None else bundle.folder.parent / called
    try:
        return None if folder is None else outline(read_bundle(folder))
    except BundleError:
        return None


def require_own_files(folder: Path) -> None:
    """Raise `BundleError` if the files of a bundle are those of another one, which it is a copy of.

    A machine's files begin with its name, which is that of the folder.
    """
    ends = tuple(f"_{part}.py" for part in DECLARATIONS)
    files = sorted(file for file in folder.glob("*_*.py") if file.name.endswith(ends))
    names = {file.stem.rpartition("_")[0]: file for file in files if file.name[:6] != "State_"}
    if len(names) == 1 and folder.stem not in names and all(map(str.isidentifier, names)):
        ((name, file),) = names.items()
        raise BundleError(
            f"this is a file of a machine {name}, and this one is {folder.stem}; of a copied or "
            f"renamed bundle, rename the files, too: (cd {shlex.quote(str(folder))} && "
            f'for f in {name}_*; do mv "$f" {shlex.quote(folder.stem)}_"${{f#{name}_}}"; done)',
            file,
        )


def require_python(bundle: Bundle) -> None:
    """Raise `BundleError` for a C++ bundle, which cannot run."""
    if bundle.language != PYTHON:
        where = Fragment("", bundle.folder)
        raise where.error("this is a C++ bundle; convert it to Python with `llfsm import`")


def _fill(state: State, source: BundleState, states: dict[str, State], scope: LoadedScope) -> None:
    """Give a state its sections and transitions."""
    for section, fragment in source.sections.items():
        tree = parse(fragment)
        if tree.body:
            tree = resolve(tree, fragment, scope.known, running=True)
            state.sections[section] = function_of(section, tree.body, fragment, scope.module)
    for each in source.transitions:
        target = states[each.target]
        expression = each.expression or Fragment("true")
        state.transitions.append(_transition(state, target, expression, scope))


def _transition(state: State, target: State, fragment: Fragment, scope: LoadedScope) -> Transition:
    declared, label = (fragment.source, 1), label_of(fragment)
    if label == "true":
        return Transition(state, target, declared, None, None, label)
    if state.runs and label in ENDS:
        ending = Transition(state, target, declared, None, None, label)
        ending.wait_for_end(done="done" in label, failed="failed" in label)
        return ending
    expression = parse_expression(fragment)
    after_ms, after, guard = _split(expression)
    transition = Transition(state, target, declared, after_ms, after, label)
    if guard is not None:
        value = resolve(guard, fragment, scope.known, running=True)
        body: list[ast.stmt] = [ast.copy_location(ast.Return(value), guard)]
        transition(function_of(EXPRESSION, body, fragment, scope.module))
    return transition


def _split(expression: ast.expr) -> tuple[float | None, float | None, ast.expr | None]:
    """Split off the milliseconds, or seconds, that `expression` waits for first."""
    found = first_wait(expression)
    if found is None:
        return None, None, expression
    name, time, first = found
    rest = None
    if isinstance(expression, ast.BoolOp) and first is not expression:
        _, *others = expression.values
        rest = others[0]
        if len(others) > 1:
            rest = ast.copy_location(ast.BoolOp(ast.And(), others), others[0])
            rest.end_lineno, rest.end_col_offset = expression.end_lineno, expression.end_col_offset
    return (time, None, rest) if name == "after_ms" else (None, time, rest)


def first_wait(expression: ast.expr) -> tuple[str, float, ast.expr] | None:
    """Find the wait that an expression begins with: "after" or "after_ms", its time, its node."""
    first = expression
    if isinstance(expression, ast.BoolOp) and isinstance(expression.op, ast.And):
        first = expression.values[0]
    match first:
        case ast.Call(
            ast.Name("after_ms" | "after" as name), [ast.Constant(int() | float() as time)], []
        ):
            return name, time, first
    return None


def _extend_search(bundle: Bundle) -> None:
    """Add the bundle's include folders to the import path."""
    for text in bundle.include_paths:
        path = os.path.expandvars(text)
        if bundle.folder is not None:
            path = os.path.normpath(bundle.folder / path)
        if path not in sys.path:
            sys.path.append(path)


def outline(bundle: Bundle) -> Table:
    """Make a table of the states, transitions and layout of `bundle`, to be drawn but not run.

    Nothing is compiled or imported, so modules that the code needs may be missing. For a Python
    bundle, the states, labels, sections and layout equal those of the class that `compile_bundle`
    returns. Variables and ports are left out. Raise `BundleError` for Python that cannot be parsed.
    """
    python = bundle.language == PYTHON
    states = _states(bundle, None)
    for each in bundle.states:
        state = states[each.name]
        for name, fragment in each.sections.items():
            if parse(fragment).body if python else without_comments(fragment.text).strip():
                state.sections[name] = TextOnly(fragment.text)
        for transition in each.transitions:
            expression = transition.expression or Fragment("true")
            label = label_of(expression) if python else cpp_label(expression)
            state.transitions.append(
                Transition(
                    state, states[transition.target], (expression.source, 1), None, None, label
                )
            )
    table = Table(str(bundle.path), tuple(states.values()), {}, {}, {})
    table.layout = bundle.layout
    return table


def cpp_label(fragment: Fragment) -> str:
    """Write a C++ expression on one line, without its comments."""
    lines = without_comments(fragment.text).split("\n")
    return " ".join(line.strip() for line in lines if line.strip()) or fragment.text.strip()
