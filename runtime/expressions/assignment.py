"""Names of a function's own that may have no value where they are used: definite assignment.

The code is followed once, from its first statement to its last, with what is known at each point
(`_Known`): the names that have a value, and those that have one only if some test held. Ways that
part at a test are joined after it. Only what is plain in the text is found. Code may know what its
text does not show: that a loop runs at least once, or that what is tested in two places is the
same. So a use counts only where nothing was tested since the test that may have left the name
without a value.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

from llfsm.runtime.expressions.reads import COMPREHENSIONS, Code, captured_names, imported_names

_Lines = dict[str, int]
_INNER: Final = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda, ast.ClassDef)


class Unassigned(NamedTuple):
    """A use, in a line, of a name without a value; or with one if another line ran, else 0."""

    name: str
    line: int
    given_at: int = 0


@dataclass
class _Known:
    """The names of a function's own that have a value at one point of its code."""

    given: set[str]
    maybe: _Lines = field(default_factory=dict)  # the lines of the tests that decided
    ends: bool = False  # whether this point is never reached

    def give(self, name: str) -> None:
        self.given.add(name)
        self.maybe.pop(name, None)

    def trust(self) -> _Known:
        """Take all names as given, inside of a condition: it may know what is not seen here."""
        return replace(self, given=self.given | self.maybe.keys(), maybe={})


def unassigned(code: Code) -> Iterator[Unassigned]:
    """Find names that have no value where they are used, or not always; each is found once."""
    own = _own_names(code.body) - code.parameters
    if own:
        reader = _Reader(own)
        reader.block(code.body, _Known(set()))
        yield from reader.found


def _own_names(body: Sequence[ast.AST]) -> set[str]:
    """Collect the names that code gives values to; none that it deletes, or has from elsewhere."""
    given, others = set[str](), set[str]()
    todo = list(body)
    while todo:
        match node := todo.pop():
            case ast.Name(name, ast.Store()):
                given.add(name)
            case ast.Name(name, ast.Del()) | ast.ExceptHandler(name=str(name)):
                others.add(name)
            case ast.Global(names) | ast.Nonlocal(names):
                others.update(names)
            case ast.Import(aliases) | ast.ImportFrom(names=aliases):
                others.update(imported_names(aliases))
            case ast.FunctionDef(name) | ast.ClassDef(name) | ast.AsyncFunctionDef(name):
                others.add(name)
            case ast.AugAssign(ast.Name(), _, value):
                todo.append(value)  # another rule finds what is only changed
                continue
        if not isinstance(node, (*_INNER, *COMPREHENSIONS)):
            todo += ast.iter_child_nodes(node)
    return given - others


class _Reader:
    def __init__(self, own: set[str]):
        self._own = own
        self._loops = 0  # around the statement
        self.found: list[Unassigned] = []

    def block(self, body: Sequence[ast.AST], known: _Known) -> _Known:
        for node in body:
            if known.ends:
                break
            known = self._statement(node, known)
        return known

    def _statement(self, node: ast.AST, known: _Known) -> _Known:
        match node:
            case ast.If(test, body, orelse):
                self._uses(test, known)
                then = self.block(body, known.trust())
                other = self.block(orelse, known.trust())
                if isinstance(test, ast.Constant):
                    return (then if test.value else other).trust()
                return self._joined(node, known, then, other, sure=_may_be_all(node))
            case ast.For(target, each, body, orelse) | ast.AsyncFor(target, each, body, orelse):
                self._uses(each, known)
                return self._loop(target, body, orelse, known)
            case ast.While(test, body, orelse):
                self._uses(test, known)
                return self._loop(test, body, orelse, known)
            case ast.With(items, body) | ast.AsyncWith(items, body):
                for item in items:
                    self._uses(item, known)
                return self.block(body, known)
            case ast.Match(subject, cases):
                self._uses(subject, known)
                return self._match(node, cases, known)
            case ast.Try(body, handlers, orelse, final) | ast.TryStar(
                body, handlers, orelse, final
            ):
                return self._try(node, (body, handlers, orelse, final), known)
            case ast.Return() | ast.Raise() | ast.Break() | ast.Continue():
                self._uses(node, known)
                return replace(known, ends=True)
            case ast.Assert():
                self._uses(node, known)
                return known.trust()
            case ast.Assign(targets, value):
                self._uses(value, known)
                for target in targets:
                    self._uses(target, known)
            case ast.AugAssign(ast.Name(name), _, value):
                self._uses(value, known)
                self._use(name, node, known)
                known.give(name)
            case ast.AnnAssign(target, _, value):
                if value is not None:
                    self._uses(value, known)
                    self._uses(target, known)
            case _:
                self._uses(node, known)
        return known

    def _joined(self, node: ast.stmt, before: _Known, *ways: _Known, sure: bool = False) -> _Known:
        """Join ways that part before and meet here; `sure` if a name of one has a value."""
        open_ways = [way for way in ways if not way.ends]
        if not open_ways:
            return replace(before, ends=True)
        given = set[str].intersection(*(way.given for way in open_ways))
        some = set[str]().union(*(way.given for way in open_ways)) - given
        left = {name: line for way in open_ways for name, line in way.maybe.items()}
        if sure or self._loops or len(open_ways) < len(ways):
            return _Known(given | some | left.keys())  # the test may have been about just that
        lines = self._lines_given([node])
        still = {name: line for name, line in before.maybe.items() if name not in lines}
        maybe = {**{name: lines.get(name, node.lineno) for name in some}, **left, **still}
        return _Known(given - maybe.keys(), maybe)

    def _loop(
        self, head: ast.expr, body: list[ast.stmt], orelse: list[ast.stmt], known: _Known
    ) -> _Known:
        inside = known.trust()
        self._uses(head, inside)  # gives its names values, or is looked at again
        self._loops += 1
        after = self.block(body, inside)
        self._loops -= 1
        left = self._names_given(body)
        trusted = _Known(known.given | known.maybe.keys() | after.given | left | inside.given)
        return self.block(orelse, trusted) if orelse else trusted

    def _match(self, node: ast.stmt, cases: list[ast.match_case], known: _Known) -> _Known:
        ways = []
        for case in cases:
            way = known.trust()
            way = replace(way, given={*way.given, *captured_names(case.pattern)})
            if case.guard is not None:
                self._uses(case.guard, way)
            ways.append(self.block(case.body, way))
        irrefutable = any(
            case.guard is None
            and isinstance(case.pattern, ast.MatchAs)
            and case.pattern.pattern is None
            for case in cases
        )
        # More cases than one may be all that there are.
        passed_by = [] if irrefutable or len(cases) > 1 else [known.trust()]
        return self._joined(node, known, *ways, *passed_by)

    def _try(
        self,
        node: ast.stmt,
        parts: tuple[list[ast.stmt], list[ast.ExceptHandler], list[ast.stmt], list[ast.stmt]],
        known: _Known,
    ) -> _Known:
        body, handlers, orelse, final = parts
        begun = replace(known, given=set(known.given), maybe=dict(known.maybe))
        tried = self.block([*body, *orelse], begun)
        ways = [tried]
        for handler in handlers:
            inside = _Known(known.given | known.maybe.keys())
            inside.given |= self._names_given(body)  # it may know how far the body came
            handled = self.block(handler.body, inside)
            kept = handled.given - (self._names_given(body) - self._names_given(handler.body))
            ways.append(replace(handled, given=kept | known.given))
        after = self._joined(node, known, *ways)
        return self.block(final, after.trust()) if final else after

    def _names_given(self, body: Sequence[ast.AST]) -> set[str]:
        return {*self._lines_given(body)}

    def _lines_given(self, body: Sequence[ast.AST]) -> _Lines:
        """Map the names to which some code gives values to the first line that does."""
        lines: _Lines = {}
        for each in (each for part in body for each in ast.walk(part)):
            if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store):
                lines[each.id] = min(each.lineno, lines.get(each.id, each.lineno))
            elif isinstance(each, ast.pattern):
                lines.update(dict.fromkeys(captured_names(each), each.lineno))
        return lines

    def _uses(self, node: ast.AST, known: _Known) -> None:
        """Look at the names in a part that is evaluated whenever it is reached."""
        match node:
            case ast.Name(name, ast.Load()):
                self._use(name, node, known)
            case ast.Name(name, ast.Store()):
                known.give(name)
            case ast.NamedExpr(ast.Name(name), value):
                self._uses(value, known)
                known.give(name)
            case ast.BoolOp(_, [first, *others]):
                self._uses(first, known)
                self._conditional(others, known)
            case ast.IfExp(test, body, orelse):
                self._uses(test, known)
                self._conditional([body, orelse], known)
            case ast.ListComp() | ast.SetComp() | ast.DictComp() | ast.GeneratorExp():
                self._uses(node.generators[0].iter, known)
                self._conditional([node], known)
            case _ if isinstance(node, _INNER):
                pass  # it runs later
            case _:
                for each in ast.iter_child_nodes(node):
                    self._uses(each, known)

    def _conditional(self, parts: Sequence[ast.AST], known: _Known) -> None:
        """Take what parts give names as given: what uses these may be as conditional."""
        for name in self._names_given(parts):
            known.give(name)

    def _use(self, name: str, node: ast.expr | ast.stmt, known: _Known) -> None:
        if name not in self._own or name in known.given:
            return
        self.found.append(Unassigned(name, node.lineno, known.maybe.get(name, 0)))
        known.give(name)  # each is reported once


def _may_be_all(node: ast.If) -> bool:
    """Check if a chain of tests of one value, without an else, may have all cases."""
    tests = [node.test]
    while len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If):
        node = node.orelse[0]
        tests.append(node.test)
    if node.orelse or len(tests) == 1:
        return False
    compared = [each for each in tests if isinstance(each, ast.Compare)]
    left = {ast.unparse(each.left) for each in compared}
    kinds = {type(op) for each in compared for op in each.ops}
    same_way = kinds <= {ast.Lt, ast.LtE} or kinds <= {ast.Gt, ast.GtE}
    return len(compared) == len(tests) and len(left) == 1 and not same_way
