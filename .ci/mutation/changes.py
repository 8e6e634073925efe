"""Mutants of Python functions: a function changed at one place, as a slip of the hand would.

A mutant is known by the qualified name of its function, by a hash of what the function does, and by
the number of the place among those of its kind: not by the file, so that it is found again when
functions move to other modules. Where a function was changed since, the statement tells the place,
if it is still there once.
"""

from __future__ import annotations

import ast
import copy
import hashlib
import random
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

KINDS = ("operator", "comparison", "constant", "dropped", "branches", "returned")
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.Div: ast.Mult, ast.Mod: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitOr, ast.And: ast.Or,
    ast.Or: ast.And,
}  # fmt: skip
_COMPARISONS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip


@dataclass(frozen=True)
class Site:
    """A place to change: `node` becomes `changed`, within a statement."""

    kind: str
    node: ast.AST
    changed: ast.AST
    statement: str


@dataclass(frozen=True)
class Function:
    """A function of the product, where it is now."""

    path: Path
    name: str  # qualified, as Python does it
    node: ast.FunctionDef | ast.AsyncFunctionDef

    @cached_property
    def digest(self) -> str:
        """A hash of what it does: neither its name nor documents and types of it count."""
        return hashlib.sha256(ast.dump(_bare(self.node)).encode()).hexdigest()[:12]

    @property
    def key(self) -> str:
        """Its name with that hash."""
        return f"{self.name}#{self.digest}"

    @cached_property
    def sites(self) -> dict[str, list[Site]]:
        """Its own places by kind, not those of functions in it, in the order of the text."""
        found = defaultdict(list)
        for site in _sites(_without_docstring(self.node)):
            found[site.kind].append(site)
        return found


def functions(root: Path) -> list[Function]:
    """List the functions of a checkout's product, fragments of machines excepted."""
    found = []
    for folder in ("whiteboard", "runtime", "bridges", "machines", "src/llfsm"):
        for path in sorted((root / folder).rglob("*.py")):
            if ".machine" not in str(path):
                tree = ast.parse(path.read_text())
                found += [Function(path, name, node) for name, node in _named(tree, "")]
    return found


def _named(
    within: ast.AST, prefix: str
) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    for node in ast.iter_child_nodes(within):
        if isinstance(node, _FUNCTIONS):
            yield prefix + node.name, node
            yield from _named(node, f"{prefix}{node.name}.<locals>.")
        elif isinstance(node, ast.ClassDef):
            yield from _named(node, f"{prefix}{node.name}.")
        else:
            yield from _named(node, prefix)


def _without_docstring(node: ast.FunctionDef | ast.AsyncFunctionDef) -> list[ast.stmt]:
    return node.body[ast.get_docstring(node) is not None :]


class _Bare(ast.NodeTransformer):
    def visit_arg(self, node: ast.arg) -> ast.arg:
        return ast.arg(node.arg)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        return ast.AnnAssign(node.target, ast.Constant(None), node.value, node.simple)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.body, node.returns = _without_docstring(node) or [ast.Pass()], None
        return self.generic_visit(node)


def _bare(node: ast.AST) -> ast.AST:
    node = copy.deepcopy(node)
    node.name = ""  # type: ignore[attr-defined]
    if isinstance(node, ast.AsyncFunctionDef):
        node.body, node.returns = _without_docstring(node) or [ast.Pass()], None
    return _Bare().visit(node)


# ---- The places of a function


def _sites(body: list[ast.stmt]) -> Iterator[Site]:
    for statement in body:
        if isinstance(statement, (*_FUNCTIONS, ast.ClassDef)):
            continue
        text = ast.unparse(statement).partition("\n")[0]
        for kind, node, changed in _changes(statement):
            yield Site(kind, node, changed, text)
        for _, value in ast.iter_fields(statement):
            inner = value if isinstance(value, list) else [value]
            for each in inner:
                if isinstance(each, ast.expr | ast.withitem):
                    yield from (Site(*found, text) for found in _in_expression(each))
                elif isinstance(each, ast.ExceptHandler):
                    yield from _sites(each.body)
                elif isinstance(each, ast.match_case):
                    if each.guard:
                        yield from (Site(*found, text) for found in _in_expression(each.guard))
                    yield from _sites(each.body)
            if inner and isinstance(inner[0], ast.stmt):
                yield from _sites(inner)


def _changes(node: ast.stmt) -> Iterator[tuple[str, ast.AST, ast.AST]]:
    match node:
        case ast.If() | ast.While():
            yield "branches", node.test, ast.UnaryOp(ast.Not(), node.test)
        case ast.Return(value=ast.expr() as value):
            if not (isinstance(value, ast.Constant) and value.value is None):
                yield "returned", node, ast.Return(ast.Constant(None))
        case ast.Raise() | ast.Continue() | ast.Break() | ast.AugAssign() | ast.Delete():
            yield "dropped", node, ast.Pass()
        case ast.Expr(value=ast.Call() | ast.Await()):
            yield "dropped", node, ast.Pass()
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield "dropped", node, ast.Pass()


def _in_expression(node: ast.AST) -> Iterator[tuple[str, ast.AST, ast.AST]]:
    """List the changes in an expression; a text with values in braces is left alone."""
    match node:
        case ast.JoinedStr() | ast.Lambda():
            return
        case ast.BinOp(left, op, right):
            is_text = isinstance(left, ast.JoinedStr) or isinstance(right, ast.JoinedStr)
            if type(op) in _OPERATORS and not is_text:
                yield "operator", node, ast.BinOp(left, _OPERATORS[type(op)](), right)
        case ast.BoolOp(op, values):
            yield "operator", node, ast.BoolOp(_OPERATORS[type(op)](), values)
        case ast.UnaryOp(ast.Not() | ast.USub() as op, operand):
            if not isinstance(op, ast.USub) or not isinstance(operand, ast.Constant):
                yield "operator", node, operand
        case ast.Compare(left, [op, *rest], comparators):
            yield (
                "comparison",
                node,
                ast.Compare(left, [_COMPARISONS[type(op)](), *rest], comparators),
            )
        case ast.IfExp(test, body, orelse):
            yield "branches", node, ast.IfExp(test, orelse, body)
        case ast.Constant(value):
            match value:
                case bool():
                    yield "constant", node, ast.Constant(not value)
                case int() | float():
                    yield "constant", node, ast.Constant(value + 1)
                case str() if value:
                    yield "constant", node, ast.Constant(f"{value}~")
                case bytes() if value:
                    yield "constant", node, ast.Constant(value + b"~")
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr | ast.keyword | ast.comprehension | ast.withitem):
            yield from _in_expression(child)


# ---- Mutants


@dataclass(frozen=True)
class Mutant:
    """A change that can be made in a checkout, and made again in a later one."""

    function: str  # its qualified name
    digest: str
    kind: str
    number: int  # of the place, among those of its kind in the function
    statement: str
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.function}: {self.before} -> {self.after}, in {self.statement!r}"


def draw(product: list[Function], number: int, seed: int) -> list[Mutant]:
    """Draw mutants: each kind as often, each function that has the kind with the same chance."""
    chance = random.Random(seed)
    places = [(each, each.sites) for each in sorted(product, key=lambda each: each.key)]
    by_kind = {
        kind: [(each, sites[kind]) for each, sites in places if kind in sites] for kind in KINDS
    }
    drawn: dict[tuple[str, str, int], Mutant] = {}
    for turn in range(100 * number):  # a small product may not have so many
        if len(drawn) == number:
            break
        kind = KINDS[turn % len(KINDS)]
        function, sites = chance.choice(by_kind[kind])
        n = chance.randrange(len(sites))
        mutant = _described(function, sites[n], n)
        drawn.setdefault((function.key, kind, n), mutant)
    return [*drawn.values()]


def _described(function: Function, site: Site, number: int) -> Mutant:
    before, after = ast.unparse(site.node), ast.unparse(site.changed)
    return Mutant(function.name, function.digest, site.kind, number, site.statement, before, after)


def find(mutant: Mutant, product: list[Function]) -> tuple[Function, Site] | None:
    """Find the place of a mutant: by what the function does, else by the statement."""
    same = [each for each in product if each.digest == mutant.digest]
    named = [each for each in same if each.name == mutant.function] or same
    if len({each.name for each in named}) == 1:
        return named[0], named[0].sites[mutant.kind][mutant.number]
    own = mutant.function.rpartition(".")[2]
    for alike in (
        [each for each in product if each.name == mutant.function],
        [each for each in product if each.name.rpartition(".")[2] == own],
        product,
    ):
        found = [
            (each, site)
            for each in alike
            for site in each.sites[mutant.kind]
            if site.statement == mutant.statement and ast.unparse(site.node) == mutant.before
        ]
        if len(found) == 1:
            return found[0]
    return None


def mutated(text: str, site: Site) -> str:
    """Return the source with the place changed."""
    node, lines = site.node, text.splitlines(keepends=True)
    assert isinstance(node, ast.expr | ast.stmt)
    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    new = ast.unparse(site.changed)
    first, last = lines[node.lineno - 1].encode(), lines[node.end_lineno - 1].encode()
    head, tail = first[: node.col_offset].decode(), last[node.end_col_offset :].decode()
    new = f"({new})" if isinstance(node, ast.expr) else new
    return "".join([*lines[: node.lineno - 1], head, new, tail, *lines[node.end_lineno :]])
