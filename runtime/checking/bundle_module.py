"""A Python bundle as one module, with the methods that its texts become, for type checkers.

The module is never run. What a type checker finds in it has a place in the bundle.
"""

from __future__ import annotations

import ast
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from ..bundles import Bundle, BundleState, Fragment, require_python
from ..bundles.code import label_of, parse, parse_expression
from ..bundles.names import MACHINE, Known, resolve, resolve_method
from ..bundles.scope import Scope
from .subject import Place

__all__ = ["BundleModule", "module_of"]


class BundleModule(NamedTuple):
    """The text of a module, and the places in a bundle of what begins at its lines and columns."""

    text: str
    places: Sequence[tuple[tuple[int, int], Place]]

    def place(self, line: int, column: int) -> Place:
        """Return the place in the bundle of a line (from 1) and column (from 0) of the text."""
        after = bisect_right(self.places, (line, column), key=lambda each: each[0])
        return self.places[max(after, 1) - 1][1]


def module_of(bundle: Bundle) -> BundleModule:
    """Return a Python bundle as a module. Raise `BundleError` where its text is wrong."""
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
    """Return the nodes of two trees that correspond, those outside before those inside."""
    yield one, other
    for pair in zip(ast.iter_child_nodes(one), ast.iter_child_nodes(other), strict=False):
        if type(pair[0]) is type(pair[1]):
            yield from _pairs(*pair)
