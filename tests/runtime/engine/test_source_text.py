"""The source of functions is found wherever and however they are written."""

from __future__ import annotations

import ast
import linecache
from collections.abc import Callable
from typing import Any
from uuid import uuid4

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.runtime import Machine, State
from llfsm.runtime.checking import check_class
from llfsm.runtime.engine.source_text import body_of, expression_of, syntax_of
from thoroughness import examples

BODIES = (
    "True", "False", "None", "1", "'a'", "(1, 2)", "-1", "1 + 1",
    "m.x", "m.x > 1", "True and m.x", "m.x and True", "1 or m.x", "m.x or 1", "False or m.y",
    "m.after(1) and not m.x", "outer", "m.x + outer", "[m.x for _ in range(3)]", "(m.x)",
    "lambda: m.x", "(lambda n: n)(m.x)", "m.f(lambda: True, lambda: False)", "m.x if m.y else True",
    "m.x  ==  'ü'", "f'{m.x}'", "...",
)  # fmt: skip

WRITINGS = (
    "def make():\n    outer = 1\n    return [{}]\n",
    "def make():\n    outer = 1\n    class C:\n        found = [{}]\n    return C.found\n",
    "outer = 2\nfound = [{}]\ndef make(): return found\n",
    "outer = 2; found = {{n: each for n, each in enumerate([{}])}}\n"
    "def make(): return list(found.values())\n",
    "outer = 2\nfound = ([], [\n  {}], 3)[1]\ndef make():\n  return found\n",
)


def made(text: str) -> list[Callable[..., Any]]:
    """Run a file of this text and return what its `make` returns."""
    name = f"<{uuid4().hex}>"
    linecache.cache[name] = (len(text), None, text.splitlines(keepends=True), name)
    namespace: dict[str, Any] = {}
    exec(compile(text, name, "exec"), namespace)
    functions: list[Callable[..., Any]] = namespace["make"]()
    return functions


def normal(text: str) -> str:
    return ast.unparse(ast.parse(text, mode="eval"))


lines = st.lists(st.sampled_from(BODIES), min_size=1, max_size=6, unique_by=normal)


@settings(max_examples=examples(50), deadline=None)
@given(lines, st.sampled_from(WRITINGS), st.sampled_from([", ", ",\n ", ", \\\n"]))
def test_each_of_several_lambdas_is_found(bodies: list[str], writing: str, separator: str) -> None:
    functions = made(writing.format(separator.join(f"lambda m: {body}" for body in bodies)))
    assert [normal(expression_of(each) or "") for each in functions] == list(map(normal, bodies))
    for function, body in zip(functions, bodies, strict=True):
        node = syntax_of(function)
        assert isinstance(node, ast.Lambda)
        assert ast.unparse(node.body) == normal(body)


@given(st.sampled_from(BODIES), st.sampled_from(BODIES))
def test_a_nested_lambda_is_distinguished_from_the_one_around_it(outside: str, inside: str) -> None:
    text = f"outer = 1\ndef make(): return [lambda m: (lambda m: {inside}, {outside})]\n"
    [function] = made(text)
    assert normal(expression_of(function) or "") == normal(f"(lambda m: {inside}, {outside})")

    class Anything:  # whatever the bodies ask of it
        x = y = 1
        after = f = staticmethod(lambda *_: 1)

    assert normal(expression_of(function(Anything)[0]) or "") == normal(inside)


def test_lambdas_that_differ_in_text_alone_are_not_guessed() -> None:
    one, other = made("def make(): return [lambda m: 2, lambda m: 1 + 1]\n")
    assert expression_of(one) in (None, "2")
    assert expression_of(other) in (None, "1 + 1")
    same = made("def make(): return [lambda m: m.x, lambda m: m.x]\n")
    assert [expression_of(each) for each in same] == ["m.x", "m.x"]


def test_a_lambda_over_several_lines() -> None:
    text = "def make():\n  return [(lambda m:\n    m.x and\n    m.y), lambda m: m.z]\n"
    assert [expression_of(each) for each in made(text)] == ["m.x and m.y", "m.z"]


@pytest.mark.parametrize(
    ("text", "expression", "body"),
    [
        ("def f(m): return m.x > 1", "m.x > 1", "return m.x > 1"),
        ("def f(m):\n    'doc'\n    return m.x", "m.x", "return m.x"),
        ("def f(m):\n    # why\n    y = 1\n    return y", None, "# why\ny = 1\nreturn y"),
        ("def f(m):\n    return", None, "return"),
        ("def f(m):\n    'doc'", None, ""),
        ("@keep\n@keep\ndef f(m):\n    return m.x", "m.x", "return m.x"),
        ("@keep  # (\n\n@(\n  keep)\ndef f(\n  m,\n):\n    return m.x", "m.x", "return m.x"),
        ("class C:\n  @keep\n  def f(m): return m.x\nf = C.f", "m.x", "return m.x"),
        ("def f(m): return 0\ng = f\ndef f(m): return 1", "1", "return 1"),
        ("f = keep(lambda m: m.x)", "m.x", "m.x"),
    ],
)
def test_functions(text: str, expression: str | None, body: str) -> None:
    [function] = made(f"def keep(f): return f\n{text}\ndef make(): return [f]\n")
    assert expression_of(function) == expression
    assert body_of(function) == body


@pytest.mark.parametrize("function", [eval("lambda m: m.x"), len, print.__call__, 3])
def test_what_has_no_source(function: Any) -> None:
    assert syntax_of(function) is None
    assert expression_of(function) is None
    assert body_of(function) is None


def test_equal_code_of_two_files_is_found_in_each() -> None:
    [one] = made("def make(): return [lambda m: m.x == 1e1]\n")
    [other] = made("def make(): return [lambda m: m.x == 10.]\n")
    assert one.__code__ == other.__code__
    assert [expression_of(one), expression_of(other)] == ["m.x == 1e1", "m.x == 10."]


def test_drawings_and_checks_find_the_same() -> None:
    """Also where the compiler leaves nothing of the expression's first half."""

    class Folded(Machine):
        x: bool = False
        a, b = State("a"), State("b")
        a.to(b, when=lambda m: True and m.x), b.to(a, when=lambda m: m.mispelt or 1)

    labels = [state.transitions[0].label for state in Folded.table.states]
    assert labels == ["True and m.x", "m.mispelt or 1"]
    [finding] = check_class(Folded)
    assert finding.text == "the machine has no 'mispelt'"
