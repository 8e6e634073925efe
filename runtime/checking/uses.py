"""What code does with its machine: which attributes it reads, assigns and calls."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from typing import TypeAlias

from .subject import Code

__all__ = ["Uses", "uses_of"]

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
        arguments = node.args
        for each in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
            if each.arg == self._machine:
                return  # another object of that name
        self._depth += 1
        self.generic_visit(node)
        self._depth -= 1
