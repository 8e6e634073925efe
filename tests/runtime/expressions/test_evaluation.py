"""An expression has the value that Python gives it, unless something with an effect is in it."""

from __future__ import annotations

import ast
import enum
import math
import re
from collections import defaultdict, namedtuple
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime.expressions.annotated import annotated, elapsed_text
from llfsm.runtime.expressions.evaluation import Evaluator
from llfsm.runtime.expressions.purity import EvaluationError
from llfsm.whiteboard import Message

effects: list[str] = []
LIMIT = 2
Place = namedtuple("Place", "x y")


class Mode(enum.Enum):
    """Two ways to drive."""

    SLOW = 1
    FAST = 2

    @property
    def is_fast(self) -> bool:
        return self is Mode.FAST


class Level(enum.IntEnum):
    """Two heights."""

    LOW = 1
    HIGH = 2


class Point(Message):
    """A message with a property and methods."""

    x: float = 3.0
    inner: Point | None = None
    ranges: tuple[float, ...] = (0.4, 0.7)

    @property
    def is_far(self) -> bool:
        return self.x > LIMIT

    def beyond(self, limit: float = 1.0) -> bool:
        return self.x > limit

    @staticmethod
    def doubled(value: float) -> float:
        return value * 2


@dataclass
class Box:
    """No message, but its attributes can be read."""

    width: int = 4


class Loud(int):
    """A number whose comparison has an effect."""

    def __gt__(self, other: int) -> bool:
        effects.append("compared")
        return True


class Listing(list):  # type: ignore[type-arg]
    """A list whose items have an effect."""

    def __getitem__(self, number: Any) -> Any:
        effects.append("item")
        return 1


class Mine:
    """No data: each operator has an effect."""

    def __eq__(self, other: object) -> bool:
        effects.append("equal")
        return True

    __hash__ = None  # type: ignore[assignment]


def shouts(value: int = 0) -> bool:
    effects.append("shouted")
    return bool(value)


def is_more(value: float, limit: float = 2) -> bool:
    return value > limit


NAMES: dict[str, Any] = {
    "a": 2,
    "b": -3,
    "word": "Bob",
    "items": [3, 1, 2],
    "table": {"x": 1, "y": 2},
    "mode": Mode.FAST,
    "level": Level.LOW,
    "point": Point(inner=Point(x=1.0)),
    "none": None,
    "place": Place(1, 2),
    "box": Box(),
    "found": {1, 2},
    "data": b"ab",
    "z": 2 + 1j,
    "counts": defaultdict(int, {"x": 1}),
    "Mode": Mode,
    "Level": Level,
    "is_more": is_more,
    "LIMIT": LIMIT,
    "Point": Point,
}
OWNER = SimpleNamespace(**NAMES)
PARTS = (
    *("a", "b", "self.a", "2", "0.5", "len(word)", "word.count('b')", "max(items)", "sum(items)"),
    *("items[-1]", "table['x']", "table.get('q', 7)", "point.x", "point.inner.x", "place.y"),
    *("box.width", "mode.value", "level", "round(2.567, 1)", "math.floor(point.x)", "z.real"),
    *(
        "abs(b)",
        "min(x * a for x in items)",
        "min((), default=9)",
        "sum(1 for x in items if x > 1)",
    ),
    *("len([y for x in items for y in (x, a) if y])", "len({x % 2 for x in items})", "a**2"),
    *("[*items, a][-1]", "max(*items, a)", "{'k': b}['k']", "(lambda_ := a) + lambda_"),
    *("sorted(items, reverse=True)[0]", "len(list(zip(items, word)))", "counts['x']", "LIMIT"),
    *("sum(v for k, v in table.items())", "Point.doubled(a)", "int(word.islower())"),
    *("len(f'{word!r:>9}|{a:03d}')", "[b, a][::-1][0]", "a if none is None else none.x"),
)
TESTS = (
    *("point.is_far", "point.beyond()", "point.beyond(9)", "mode.is_fast", "is_more(a)"),
    *("is_more(a, limit)".replace("limit", "b"), "none is None", "mode is Mode.SLOW"),
    *("word.startswith(('A', 'B'))", "word.lower() == 'bob'", "1 < a < 3 != b", "'x' in table"),
    *("any(x > 2 for x in items)", "all(r < 0.5 for r in point.ranges)", "isinstance(a, int)"),
    *("isinstance(point, (Point, str))", "found <= {1, 2, 3}", "level == Level.LOW", "not a"),
    *("any((hit := x) > 2 for x in items) and hit == 3", "math.isclose(a, 2.0, rel_tol=0.1)"),
    *("a in range(10**9)", "data == b'ab'", "word[::-1] == 'boB'", "none and none.x > 9"),
    *(
        "{k: v for k, v in table.items()} == table",
        "(point, a) == (point, 2)",
        "items == [3, 1, 2]",
    ),
)
NUMBERS = st.sampled_from([f"({part})" for part in PARTS])
COMPARED = st.builds(
    "{} {} {}".format, NUMBERS, st.sampled_from(["<", "==", ">=", "!=", "> 0 <"]), NUMBERS
)
EXPRESSIONS = st.recursive(
    COMPARED | st.sampled_from([f"({test})" for test in TESTS]),
    lambda inner: (
        st.builds("({} {} {})".format, inner, st.sampled_from(["and", "or", "=="]), inner)
        | st.builds("(not {})".format, inner)
        | st.builds("({} if {} else {})".format, inner, inner, inner)
    ),
    max_leaves=6,
)


def tree(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


def without_names(shown: str, text: str) -> str:
    """Leave the values of parts, without the parts before them."""
    named = ast.Name | ast.Attribute | ast.Subscript | ast.Call
    parts = {ast.unparse(each) for each in ast.walk(tree(text)) if isinstance(each, named)}
    for part in sorted(parts | {each.replace("self.", "") for each in parts}, key=len)[::-1]:
        shown = re.sub(rf"(?<![\w.]){re.escape(part)}=(?! )", "", shown)
    return shown


@given(EXPRESSIONS)
def test_an_expression_has_the_value_that_python_gives_it(text: str) -> None:
    """So has the text with the operands in their places, as far as they can be written."""
    expected = eval(text, {"math": math, "self": OWNER, **NAMES})
    evaluator = Evaluator(OWNER)
    assert evaluator.value(tree(text)) == expected
    shown = without_names(annotated(evaluator, text), text)
    is_whole = "…" not in shown  # long values are cut
    if is_whole and not {"point", "hit", "range"} & {*shown.replace("(", " ").split()}:
        assert eval(shown, {**NAMES, "math": math}) == expected


@pytest.mark.parametrize("text", [*PARTS, *TESTS])
def test_each_part_is_evaluated(text: str) -> None:
    assert Evaluator(OWNER).value(tree(text)) == eval(text, {"math": math, "self": OWNER, **NAMES})


HARMFUL = SimpleNamespace(
    **NAMES,
    shouts=shouts,
    loud=Loud(3),
    listing=Listing([1]),
    mine=Mine(),
    left=iter([1]),
    nested=[(Mine(),)],
    popping=[1, 2].pop,
    huge=range(10**12),
    yielding=(effects.append("yielded") for _ in range(3)),
    word2="x" * 10**6,
)


@pytest.mark.parametrize(
    "text",
    [
        *("shouts()", "shouts(a)", "items.append(4)", "items.pop()", "items.sort()", "popping()"),
        *("found.add(9)", "table.pop('x')", "table.setdefault('q', 1)", "counts['new']"),
        *("loud > 2", "max(loud, 2)", "listing[0]", "listing == [1]", "mine == 1", "mine in [1]"),
        *("nested == [1]", "nested[0] == 1", "sorted(nested)", "sum(left)", "[x for x in left]"),
        *("sorted(items, key=shouts)", "max(items, key=lambda x: shouts())", "isinstance(a, huge)"),
        *("[shouts() for x in items]", "any(shouts() for x in items)", "(lambda: a)()"),
        *("exec('1')", "open('x')", "__import__('os')", "a.__class__", "Point.__subclasses__()"),
        *("sum(huge)", "[x for x in huge]", "[*huge]", "sorted(huge)", "word2 * 10**6"),
        *("2 ** 10**9", "sum(yielding)", "[x for x in yielding]", "any(x for x in yielding)"),
        *("1 << 10**9", "'%99999999999d' % a", "f'{a:99999999999}'", "round(a, -10**9)"),
        *("math.factorial(10**9)", "math.comb(10**9, 10**8)", "word.ljust(10**12)", "missing"),
        *("point.missing", "point.beyond(1, 2)", "point.beyond(limit=9)", "max(*items, **table)"),
    ],
)
def test_nothing_with_an_effect_is_done_and_nothing_without_an_end(text: str) -> None:
    effects.clear()
    before = repr((NAMES["items"], NAMES["table"], NAMES["found"], NAMES["counts"]))
    with pytest.raises((EvaluationError, TypeError)):
        Evaluator(HARMFUL).value(tree(text))
    assert isinstance(annotated(Evaluator(HARMFUL), text), str)
    assert effects == []
    assert repr((NAMES["items"], NAMES["table"], NAMES["found"], NAMES["counts"])) == before


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("self.items.append(a) or b > 1", "(items=[3, 1, 2]).append(2) or b=-3 > 1"),
        ("none.inner.x > 9", "(none=None).inner.x > 9"),
        ("none is not None and none.inner.x > a", "none=None is not None and none.inner.x > a=2"),
        ("a > 3 and b > 1", "a=2 > 3 and b=-3 > 1"),
        ("none.x if none else a", "none.x if none=None else a=2"),
        ("0.1 + c == d", "0.1 + c=0.2 == d=0.3"),
        ("c + 0.1 == d", "c=0.2 + 0.1 == d=0.3"),
        ("e == d", "e=0.30000000000000004 == d=0.3"),
        ("b**2 == 9", "(b=-3) ** 2 == 9"),
        ("[x + a for x in missing]", "[x + a=2 for x in missing]"),
        ("any(x > a for x in left)", "any((x > 2 for x in left))"),
        ("word == 'a\\x1b[31m'", "word='\\x1b[2J' == 'a\\x1b[31m'"),
        ("mode is Mode.SLOW", "mode=Mode.FAST is Mode.SLOW"),
        ("(k := a * 2) > 9 and k < 7", "(k := (a=2 * 2)) > 9 and k=4 < 7"),
    ],
)
def test_values_are_beside_parts(text: str, shown: str) -> None:
    more = {"c": 0.2, "d": 0.3, "e": 0.1 + 0.2, "left": iter(()), "word": "\x1b[2J"}
    assert annotated(Evaluator(SimpleNamespace(**(NAMES | more))), text) == shown


def test_an_elapsed_time_looks_other_than_the_limit_that_it_has_passed() -> None:
    assert elapsed_text(320_000_000, 1000.0) == "320 ms > 1000 ms"
    assert elapsed_text(1_000_000_400, 1000.0) == "1000.0004 ms > 1000 ms"
    assert elapsed_text(2_500_000_000, 2, "after") == "2.5 s > 2 s"


def test_what_an_owner_had_then_is_used() -> None:
    evaluator = Evaluator(OWNER, attributes={"a": 7, "items": [9]})
    assert evaluator.value(tree("self.a + items[0] + b")) == 13
