"""Resolve the bare names of a bundle's code: variables, ports and functions of its machine.

In a section, ``count`` is the machine's variable and ``after_ms(10)`` asks the machine, as in
clfsm. The syntax tree is rewritten so that such a name is an attribute of the machine, which
every function takes as a hidden parameter. The code is then as fast as a method, and keeps its
line numbers. Names that the code binds itself, as in a lambda, keep their meaning in Python.
"""

from __future__ import annotations

import ast
import builtins
from collections.abc import Iterator, Mapping, Set
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar

from llfsm.errors import nothing_called
from llfsm.runtime.bundles.model import Fragment
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.expressions.reads import (
    MACHINE,
    all_parameters,
    bound_names,
    header_of,
    imported_names,
    parameter_names,
)

UNTRANSLATED = "UNTRANSLATED"
"""The name that marks what an import leaves to be translated by hand."""

_ALWAYS_KNOWN = frozenset(dir(builtins)) | {"__class__"}
N = TypeVar("N", bound=ast.AST)


class Meaning(NamedTuple):
    """The meaning of a bare name: an attribute of the machine, and its kind, for errors."""

    attribute: str
    kind: str
    variable: bool = False  # whether code may assign it


class Known(NamedTuple):
    """The names that code may use: those of the machine, and those of its module."""

    machine: Mapping[str, Meaning]
    module: dict[str, Any]


def resolve(tree: N, fragment: Fragment, known: Known, *, running: bool) -> N:
    """Make the names of the machine in `tree` its attributes.

    `running` is False for code that is evaluated when the bundle is loaded. Raise `BundleError`
    for names that nothing defines and for what cannot be done with those of the machine.
    """
    resolved: N = _Resolver(fragment, known, running).resolve(tree)
    return resolved


def resolve_method(function: ast.FunctionDef, fragment: Fragment, known: Known) -> None:
    """Resolve a function of the machine in place: its header, then its body, as `resolve` does."""
    for node in (*function.decorator_list, *header_of(function)):
        # Nothing in it can be the machine's, so that nothing is replaced.
        _Resolver(fragment, known, running=False).resolve(node)
    _Resolver(fragment, known, running=True).resolve_body(function)


def is_mark(node: ast.stmt) -> bool:
    """Check for the mark of what an import has left to be translated."""
    return isinstance(node, ast.Expr) and getattr(node.value, "id", None) == UNTRANSLATED


def untranslated(fragment: Fragment, node: ast.stmt | ast.expr) -> BundleError:
    """Make the error of a mark."""
    what = f"this C++ is not translated yet: write the Python, and delete {UNTRANSLATED}"
    return fragment.error(what, node.lineno)


class _Resolver(ast.NodeTransformer):
    def __init__(self, fragment: Fragment, known: Known, running: bool):
        self._fragment = fragment
        self._known = known
        self._running = running
        self._here: frozenset[str] = frozenset()  # what the code has bound itself
        self._inner: frozenset[str] = frozenset()  # of that, what functions inside it see

    def resolve(self, tree: ast.AST) -> Any:
        self._here = self._inner = frozenset(bound_names([tree]) - self._known.machine.keys())
        return self.visit(tree)

    def resolve_body(self, function: ast.FunctionDef) -> None:
        bound = bound_names(function.body) - self._known.machine.keys()
        self._here = self._inner = frozenset(bound | parameter_names(function.args))
        function.body = [self.visit(each) for each in function.body]

    def visit_Name(self, node: ast.Name) -> ast.AST:
        name = node.id
        if name == "self" and self._running and name not in self._here:
            return _at(node, _machine())
        meaning = None if name in self._here else self._known.machine.get(name)
        if meaning is None:
            if isinstance(node.ctx, ast.Load):
                self._check_known(node)
            return node
        if not self._running:
            raise self._error(
                node, f"{name!r} is {meaning.kind}: it does not exist before the machine runs"
            )
        if isinstance(node.ctx, ast.Del) or (
            isinstance(node.ctx, ast.Store) and not meaning.variable
        ):
            done = "deleted" if isinstance(node.ctx, ast.Del) else "assigned"
            raise self._error(node, f"{name!r} is {meaning.kind}: it cannot be {done}")
        return _at(node, ast.Attribute(_at(node, _machine()), meaning.attribute, node.ctx))

    # What binds names, but no attributes

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if isinstance(node.target, ast.Name):
            self._refuse(node.target, node.target.id, "declared here")
        return self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        if isinstance(node.target, ast.Name) and node.target.id not in self._known.machine:
            self._check_known(node.target)
        return self.generic_visit(node)

    def visit_NamedExpr(self, node: ast.NamedExpr) -> ast.AST:
        self._refuse(node, node.target.id, "assigned by :=")
        return self.generic_visit(node)

    def _import(self, node: ast.Import | ast.ImportFrom) -> ast.AST:
        for name in imported_names(node.names):
            self._refuse(node, name, "imported")
        return node

    visit_Import = visit_ImportFrom = _import

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> ast.AST:
        self._refuse(node, node.name, "bound by except")
        return self.generic_visit(node)

    def _pattern(self, node: ast.MatchAs | ast.MatchStar | ast.MatchMapping) -> ast.AST:
        name = node.rest if isinstance(node, ast.MatchMapping) else node.name
        self._refuse(node, name, "bound by a pattern")
        return self.generic_visit(node)

    visit_MatchAs = visit_MatchStar = visit_MatchMapping = _pattern

    def visit_Global(self, node: ast.Global) -> ast.AST:
        raise self._error(node, "machines share no variables: leave out `global`")

    def visit_Nonlocal(self, node: ast.Nonlocal) -> ast.AST:
        for name in node.names:
            if self._is_machine_name(name):
                raise self._error(node, f"{name!r} belongs to the machine: leave out `nonlocal`")
        return node

    # Scopes inside the code

    def visit_Lambda(self, node: ast.Lambda) -> ast.AST:
        self._visit_outside(node.args)
        with self._scope(parameter_names(node.args) | bound_names([node.body])):
            node.body = self.visit(node.body)
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        self._refuse(node, node.name, "the name of a class")
        node.decorator_list = [self.visit(each) for each in node.decorator_list]
        node.bases = [self.visit(each) for each in node.bases]
        node.keywords = [self.visit(each) for each in node.keywords]
        seen_inside = self._inner
        with self._scope(bound_names(node.body)):
            self._inner = seen_inside  # functions do not see what the class around them binds
            node.body = [self.visit(each) for each in node.body]
        return node

    def _function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> ast.AST:
        self._refuse(node, node.name, "the name of a function")
        node.decorator_list = [self.visit(each) for each in node.decorator_list]
        self._visit_outside(node.args)
        if node.returns:
            node.returns = self.visit(node.returns)
        with self._scope(parameter_names(node.args) | bound_names(node.body)):
            node.body = [self.visit(each) for each in node.body]
        return node

    visit_FunctionDef = visit_AsyncFunctionDef = _function

    def _comprehension(
        self, node: ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp
    ) -> ast.AST:
        first = node.generators[0]
        first.iter = self.visit(first.iter)  # evaluated outside
        with self._scope(bound_names([generator.target for generator in node.generators])):
            for generator in node.generators:
                generator.target = self.visit(generator.target)
                if generator is not first:
                    generator.iter = self.visit(generator.iter)
                generator.ifs = [self.visit(each) for each in generator.ifs]
            for part in ("key", "value", "elt"):
                if hasattr(node, part):
                    setattr(node, part, self.visit(getattr(node, part)))
        return node

    visit_ListComp = visit_SetComp = visit_DictComp = visit_GeneratorExp = _comprehension

    @contextmanager
    def _scope(self, bound: Set[str]) -> Iterator[None]:
        here, inner = self._here, self._inner
        self._here = self._inner = inner | bound
        yield
        self._here, self._inner = here, inner

    def _visit_outside(self, arguments: ast.arguments) -> None:
        """Resolve what a function's header evaluates where it stands."""
        arguments.defaults = [self.visit(each) for each in arguments.defaults]
        arguments.kw_defaults = [each and self.visit(each) for each in arguments.kw_defaults]
        for argument in all_parameters(arguments):
            if argument.annotation:
                argument.annotation = self.visit(argument.annotation)

    # Checks

    def _refuse(self, node: ast.AST, name: str | None, done: str) -> None:
        if name is not None and self._is_machine_name(name):
            kind = self._known.machine[name].kind
            raise self._error(node, f"{name!r} is {kind}: it cannot be {done}")

    def _is_machine_name(self, name: str) -> bool:
        return name in self._known.machine and name not in self._here

    def _check_known(self, node: ast.Name) -> None:
        name = node.id
        if name in self._here or name in self._known.module or name in _ALWAYS_KNOWN:
            return
        if name == UNTRANSLATED:
            raise untranslated(self._fragment, node)
        known = {*self._known.machine, *self._known.module}
        raise self._error(node, nothing_called(name, known))

    def _error(self, node: Any, what: str) -> Exception:
        return self._fragment.error(what, node.lineno)


def included_names(statements: list[ast.stmt]) -> frozenset[str] | None:
    """Collect the names that includes import or define; None if they cannot be determined."""
    nodes = [node for each in statements for node in ast.walk(each)]
    from_functions = {n for node in nodes if isinstance(node, ast.Global) for n in node.names}
    names = bound_names(statements) | from_functions
    return None if "*" in names else frozenset(names)


def _machine() -> ast.Name:
    return ast.Name(MACHINE, ast.Load())


def _at(node: ast.AST, new: N) -> N:
    return ast.copy_location(new, node)
