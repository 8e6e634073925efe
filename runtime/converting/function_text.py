"""The texts of a class's functions as a bundle has them: bare names instead of ``self.name``."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any

from ..bundles.names import bound_names
from ..bundles.scope import CONTROLS
from ..engine.errors import BundleError
from ..engine.source_text import parse_file, syntax_of
from .edited_text import EditedText
from .imports import Imports

if TYPE_CHECKING:
    from ..engine.source_text import FunctionSyntax

__all__ = ["FunctionTexts", "refusal"]

_LOOSE = (ast.IfExp, ast.Lambda, ast.NamedExpr)
"""Expressions that need parentheses behind `and`."""
_TWICE = "{!r} is of the module here, and the machine has one, too; rename one of them"


def refusal(what: str, file: Path, line: int | None) -> BundleError:
    """Return the error of what a bundle cannot have."""
    return BundleError(f"cannot be made a bundle: {what}", file, line)


class FunctionTexts:
    """The texts of a machine with these variables, ports and methods, whose imports it collects.

    `others` are what else the class has, and a bundle lacks. `called` are the methods that the
    texts name, `written` those whose texts were made.
    """

    def __init__(self, names: set[str], others: set[str], cls: type):
        self.names = names
        self.others = others
        self.imports = Imports()
        self.called: set[str] = set()
        self.written: set[str] = set()
        self._known = names | CONTROLS.keys()
        self._module = vars(sys.modules[cls.__module__])

    def declaration(self, file: Path, whole: ast.stmt, part: ast.stmt | ast.expr) -> str:
        """Return the text of a statement of the class body, or of its value."""
        text = self._text(file)
        for node in _loaded(whole):
            if node.id in self.others:
                raise refusal(f"{node.id!r} is an attribute of the class", file, node.lineno)
            if node.id in self.names and node.id in self._module:
                raise refusal(_TWICE.format(node.id), file, node.lineno)
            if node.id not in self.names and node.id not in bound_names([whole]):
                self.imports.need(node.id, self._module, file, node.lineno)
        last = part.end_lineno or part.lineno
        text.indent(part.lineno + 1, last, -whole.col_offset)
        end = text.end(part)
        comment = text.find(rb"[ \t]*#[^\n]*", end) if part is whole else None
        return text.text(text.start(part), comment.end() if comment else end)

    def section(self, code: Any, what: str, line: int) -> str:
        """Return the statements of a section."""
        function, node, text, file = self._read(code, what, line)
        return self._body(function, node, text, file, what)

    def method(self, function: FunctionType) -> str:
        """Return a function of the machine, without its parameter for the machine."""
        what = f"function {function.__name__!r}"
        self.written.add(function.__name__)
        _, node, text, file = self._read(function, what, 1, is_alone=False)
        assert isinstance(node, ast.FunctionDef)
        if node.args.posonlyargs or not node.args.args:
            raise refusal(f"{what} is written with /, or without self", file, node.lineno)
        for default in _outside(node):
            for name in _loaded(default):
                if name.id in self._known | self.others:
                    raise refusal(
                        f"{what} names {name.id!r} of the class in its header", file, name.lineno
                    )
                self.imports.need(name.id, function.__globals__, file, name.lineno)
        first = node.args.args[0]
        comma = text.find(rb"\s*,\s*", text.end(first))
        text.replace(text.start(first), comma.end() if comma else text.end(first), "")
        self._rewrite(function, node, text, file, what)
        last = node.end_lineno or node.lineno
        text.indent(node.lineno, last, -node.col_offset)
        return text.text(text.line_start(node.lineno), text.line_start(last + 1)).rstrip() + "\n"

    def expression(self, guard: Any, what: str, line: int, *, is_alone: bool) -> str | None:
        """Return what a guard returns; None if it has other statements, too."""
        function, node, text, file = self._read(guard, what, line)
        if isinstance(node, ast.Lambda):
            value = node.body
            start, end = text.start(value), text.end(value)
        else:
            body = _undocumented(node)
            if len(body) != 1 or not isinstance(body[0], ast.Return) or body[0].value is None:
                return None
            value = body[0].value
            start, end = text.start(body[0]) + len("return"), text.end(body[0])
        self._rewrite(function, node, text, file, what)
        if value.end_lineno is not None:
            text.indent(value.lineno + 1, value.end_lineno, -200)
        made = text.text(start, end).strip()
        is_loose = isinstance(value, _LOOSE) or (
            isinstance(value, ast.BoolOp) and isinstance(value.op, ast.Or)
        )
        is_true = made in ("true", "True")
        if is_true or "\n" in made or (is_loose and not is_alone):
            return f"({made})"
        return made

    def _body(
        self, function: FunctionType, node: FunctionSyntax, text: EditedText, file: Path, what: str
    ) -> str:
        self._rewrite(function, node, text, file, what)
        if isinstance(node, ast.Lambda):
            return text.text(text.start(node.body), text.end(node.body)) + "\n"
        body = _undocumented(node)
        if not body:
            return "pass\n"
        first, last = body[0].lineno, body[-1].end_lineno or body[-1].lineno
        end = text.line_start(last + 1)
        if first == node.lineno:  # def f(self): a; b
            return text.text(text.start(body[0]), end).rstrip() + "\n"
        while text.line(first - 1).lstrip()[:1] == "#":
            first -= 1
        text.indent(first, last, -body[0].col_offset)
        return text.text(text.line_start(first), end).rstrip() + "\n"

    def _read(
        self, code: Any, what: str, line: int, *, is_alone: bool = True
    ) -> tuple[FunctionType, FunctionSyntax, EditedText, Path]:
        """Return a function's syntax and text; refuse one whose text is not all there is to it."""
        if not isinstance(code, FunctionType):
            what = f"{what} is {code!r}, not a function written in Python"
            raise refusal(what, Path(self._module["__file__"]), line)
        file, line = Path(code.__code__.co_filename), code.__code__.co_firstlineno
        if free := code.__code__.co_freevars:
            uses = "super()" if free == ("__class__",) else f"{free[0]!r} of the code around it"
            raise refusal(f"{what} uses {uses}", file, line)
        node = syntax_of(code)
        if node is None:
            raise refusal(f"the text of {what} cannot be found", file, line)
        arguments = node.args
        several = (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)
        if is_alone and (len(several) != 1 or arguments.vararg or arguments.kwarg):
            raise refusal(f"{what} has parameters besides the machine", file, line)
        return code, node, self._text(file), file

    def _text(self, file: Path) -> EditedText:
        parsed = parse_file(str(file))
        assert parsed is not None  # a node of it has been found
        return EditedText(parsed[0])

    def _rewrite(
        self, function: FunctionType, node: FunctionSyntax, text: EditedText, file: Path, what: str
    ) -> None:
        """Leave out the machine where a bundle's code does, and import what else is named."""
        body = node.body if isinstance(node.body, list) else [node.body]
        machine = (*node.args.posonlyargs, *node.args.args)[0].arg
        parameters = {each.arg for each in ast.walk(node.args) if isinstance(each, ast.arg)}
        inner = {each.arg for part in body for each in ast.walk(part) if isinstance(each, ast.arg)}
        stored = {
            each.id
            for part in body
            for each in ast.walk(part)
            if isinstance(each, ast.Name) and not isinstance(each.ctx, ast.Load)
        }
        own = bound_names([*body])
        hidden = (parameters - {machine}) | inner | stored | own
        if clash := (own - parameters) & self._known:
            raise refusal(
                f"{what} has a local variable {min(clash)!r}, as the machine has; rename it",
                file,
                _line_of(body, min(clash)),
            )
        if machine in hidden or (machine != "self" and "self" in hidden):
            raise refusal(f"{what} binds the name of the machine anew", file, node.lineno)
        for part in body:
            for each in ast.walk(part):
                if isinstance(each, ast.Attribute) and _is_name(each.value, machine):
                    if each.attr in self.others:
                        raise refusal(
                            f"{what} uses {each.attr!r}, which a bundle's code cannot name",
                            file,
                            each.lineno,
                        )
                    self.called.add(each.attr)
            for name in _loaded(part):
                if name.id == machine or name.id in hidden:
                    continue
                if name.id in self._known:
                    raise refusal(_TWICE.format(name.id), file, name.lineno)
                self.imports.need(name.id, function.__globals__, file, name.lineno)
            text.replace_names(part, self._bare(machine, hidden))

    def _bare(self, machine: str, hidden: set[str]) -> Callable[[ast.expr], ast.expr | None]:
        def bare(node: ast.expr) -> ast.expr | None:
            match node:
                case ast.Attribute(ast.Name(name), attribute) if name == machine:
                    if attribute in self._known and attribute not in hidden:
                        return ast.Name(attribute)
                    return ast.Attribute(ast.Name("self"), attribute, node.ctx)
                case ast.Name(name) if name == machine:
                    return ast.Name("self")
            return None

        return bare


def _loaded(tree: ast.AST) -> Iterator[ast.Name]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            yield node


def _is_name(node: ast.expr, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def _line_of(body: list[Any], name: str) -> int:
    """Return the line on which a function binds a name."""
    for part in body:
        for each in ast.walk(part):
            if isinstance(each, ast.Name) and each.id == name:
                return each.lineno
    return int(body[0].lineno)


def _outside(function: ast.FunctionDef) -> list[ast.expr]:
    arguments = function.args
    every = [*arguments.args, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg]
    found = [function.returns, *(each.annotation for each in every if each is not None)]
    found += [*arguments.defaults, *arguments.kw_defaults]
    return [each for each in found if each is not None]


def _undocumented(function: ast.FunctionDef) -> list[ast.stmt]:
    return function.body[ast.get_docstring(function, clean=False) is not None :]
