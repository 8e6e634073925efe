"""What code does with its machine: which attributes it reads, assigns and calls."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

from llfsm.runtime.checking.subject import Code

_Function: TypeAlias = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


@dataclass
class Uses:
    """The attributes of the machine that a piece of code names, each with its first line.

    `escapes` is True if the machine itself is passed on, so that other code may use it;
    `returns` is True if the code can return a value.
    """

    loaded: dict[str, int] = field(default_factory=dict)
    stored: dict[str, int] = field(default_factory=dict)
    called: dict[str, int] = field(default_factory=dict)
    escapes: bool = False
    returns: bool = False


def uses_of(code: Code) -> Uses:
    """Return what `code` does with its machine."""
    visitor = _Visitor(code.machine)
    for node in code.body:
        visitor.visit(node)
    return visitor.uses


def nodes_of(code: Code) -> Iterator[ast.AST]:
    """Return the nodes of `code`, without functions in which the machine's name means another."""
    todo = [*code.body]
    while todo:
        node = todo.pop()
        if not (isinstance(node, _Function) and _hides(node, code.machine)):
            yield node
            todo += ast.iter_child_nodes(node)


def parameter_names(arguments: ast.arguments) -> frozenset[str]:
    """Return the names of all parameters."""
    named = (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)
    starred = (arguments.vararg, arguments.kwarg)
    return frozenset(each.arg for each in (*named, *starred) if each is not None)


def _hides(node: _Function, name: str) -> bool:
    """Return whether a function has a parameter of that name, so another object is called so."""
    return name in parameter_names(node.args)


class _Visitor(ast.NodeVisitor):
    def __init__(self, machine: str):
        self.uses = Uses()
        self._machine = machine
        self._depth = 0  # of functions inside the code

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if isinstance(node.value, ast.Name) and node.value.id == self._machine:
            loaded = isinstance(node.ctx, ast.Load)
            names = self.uses.loaded if loaded else self.uses.stored
            names.setdefault(node.attr, node.lineno)
        else:
            self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        match node.target:
            case ast.Attribute(ast.Name(name), attribute) if name == self._machine:
                self.uses.loaded.setdefault(attribute, node.lineno)  # it must be there
                self.visit(node.value)
            case _:
                self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        match node.func:
            case ast.Attribute(ast.Name(name), attribute) if name == self._machine:
                self.uses.called.setdefault(attribute, node.lineno)
        self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> None:
        self.uses.escapes |= node.id == self._machine

    def visit_Return(self, node: ast.Return) -> None:
        self.uses.returns |= node.value is not None and not self._depth
        self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self._function(node)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> None:
        self._function(node)

    def visit_Lambda(self, node: ast.Lambda) -> None:
        self._function(node)

    def _function(self, node: _Function) -> None:
        if _hides(node, self._machine):
            return
        self._depth += 1
        self.generic_visit(node)
        self._depth -= 1
