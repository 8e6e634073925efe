"""C++ expressions are translated to the same meaning, or not at all."""

from __future__ import annotations

import random
import subprocess
from pathlib import Path

import pytest

from llfsm.runtime.bundles.cpp import CppVariable, translate_condition, translate_value

VARIABLES = {
    name: CppVariable(name, kind)
    for name, kind in {
        "i": "int", "j": "int", "k": "int", "l": "long", "u": "unsigned", "w": "unsigned",
        "b": "bool", "c": "bool", "d": "float", "e": "float", "f": "single", "s": "string",
    }.items()
} | {"status": CppVariable("status_", "int")}  # fmt: skip


@pytest.mark.parametrize(
    ("cpp", "python"),
    [
        ("true", "True"),
        ("false", "False"),
        ("1", "True"),
        ("0", "False"),
        ("0.0", "False"),
        ("after_ms(1000)", "after_ms(1000)"),
        ('after(0.5) && !is_running("GetUp")', "after(0.5) and (not is_running('GetUp'))"),
        ("timeout( 500000 )", "timeout(500000)"),
        ("is_suspended(s)", "is_suspended(s)"),
        ("!b && i > 2", "not b and i > 2"),
        ("b||c&&i==j", "b or (c and i == j)"),
        ("(b || c) && !(i == j)", "(b or c) and (not i == j)"),
        ("b && c && b", "b and c and b"),
        ("!i", "not i != 0"),
        ("i", "i != 0"),
        ("i && d", "i != 0 and d != 0"),
        ("!b == c", "(not b) == c"),
        ("i < j < k", "(i < j) < k"),
        ("i == j < k", "i == (j < k)"),
        ("i - j - k > 0", "i - j - k > 0"),
        ("i - (j - k) > 0", "i - (j - k) > 0"),
        ("-i * 2 > - -3", "-i * 2 > --3"),
        ("d / 2.0 > 1e3", "d / 2.0 > 1000.0"),
        ("d / 2 >= .5", "d / 2 >= 0.5"),
        ("0x1F != i", "31 != i"),
        ("1000L < l", "1000 < l"),
        ("u > 3 && u == w", "u > 3 and u == w"),
        ("f > 10 && f <= 0.5f", "f > 10 and f <= 0.5"),
        ("status == 1", "status_ == 1"),
        ("i > 2 // enough", "i > 2"),
        ("i >\n 2 /* enough */", "i > 2"),
    ],
)
def test_translated(cpp: str, python: str) -> None:
    assert translate_condition(cpp, VARIABLES) == python


@pytest.mark.parametrize(
    "cpp",
    [
        "", "i >", "i = 3", "i > 2;", "i 2", "(i", "i)", "()", "x", "CONSTANT > 2", "a.b()", "i->x",
        "i[0]", "std::abs(i)", "rand()", "i++", "++i", "--i", "i--", "i - --j", "i ? b : c",
        "i & 2", "i | 2", "i ^ 2", "~i", "i << 2", "i >> 2", "i <<= 2", "i <=> j", "i += 2", "!",
        "i / 2", "i % 2", "d / i", "d / 0", "d / 0.0", "i / 2 > 0.5", "l / 2.0",
        "u - 1 > 0", "-u > 0", "u > -1", "u > i", "i < u", "u == j", "u + 1.0 > d",
        "i > 2u - 3", "l > 0.5", "l == d", "f > 0.1", "f == d", "f * 2 > 1", "f + f > 0", "0.1f",
        "s", "!s", "s == s", 's == "x"', '"x"', "'a'", "i == 'a'", '"a" "b"', '"a\\"b"',
        "017", "08", "1'000", "0b11", "3000000000", "0xFFFFFFFF", "1ull", "1.0L", "1e400f", "10x",
        "after_ms(\"x\")", "is_running(1)", "is_running(x)", "after_ms()", "after_ms(1, 2)",
        "after_ms", "suspend(\"M\")", "machine_id() > 0", "i(3)", "and", "b and c", "not b",
        "(int)d > 2", "true()", "\\", "i @ j", "ünder > 2", "#define",
        "(" * 300 + "b" + ")" * 300, "!" * 200 + "b", "-" + "(-" * 200 + "i" + ")" * 200,
    ],
)  # fmt: skip
def test_refused(cpp: str) -> None:
    assert translate_condition(cpp, VARIABLES) is None


@pytest.mark.parametrize(
    ("cpp", "kind", "python"),
    [
        ("3", "int", "3"), ("-3", "int", "-3"), ("3", "long", "3"), ("3", "unsigned", "3"),
        ("-3", "unsigned", None), ("3.5", "int", None), ("3", "float", "3.0"),
        ("-3", "float", "-3.0"), ("-1", "single", "-1.0"),
        ("2.5", "float", "2.5"), ("0.5", "single", "0.5"), ("0.1", "single", None),
        ("true", "bool", "True"), ("1", "bool", None), ('"x y"', "string", "'x y'"),
        ('"x"', "int", None), ("2 + 3", "int", None), ("i", "int", None), ("", "int", None),
    ],
)  # fmt: skip
def test_values(cpp: str, kind: str, python: str | None) -> None:
    assert translate_value(cpp, kind) == python


def test_a_function_hidden_by_a_variable_is_not_called() -> None:
    assert translate_condition("after(1)", {"after": CppVariable("after_", "int")}) is None


VALUES = {
    "i": 3, "j": -2, "k": 0, "l": 5, "u": 4, "w": 0, "b": True, "c": False, "d": 0.5, "e": -1.5,
    "f": 0.25,
}  # fmt: skip
TYPES = {
    "i": "int", "j": "int", "k": "int", "l": "long", "u": "unsigned", "w": "unsigned",
    "b": "bool", "c": "bool", "d": "double", "e": "double", "f": "float",
}  # fmt: skip


def grown(chance: random.Random, depth: int) -> str:
    """Return a random expression, with few parentheses, so that precedence matters."""
    if depth == 0:
        return chance.choice([*VALUES, "2", "0", "1", "0.5", "1.5", "7u", "true"])
    left, right = grown(chance, depth - 1), grown(chance, chance.randrange(depth))
    sign = chance.choice(
        ["&&", "||", "==", "!=", "<", ">", "<=", ">=", "+", "-", "*", "/", "!", "()"]
    )
    if sign == "!":
        return f"!{left}"
    if sign == "()":
        return f"({left})"
    return f"{left} {sign} {right}"


@pytest.mark.compiler
def test_the_compiler_agrees(tmp_path: Path) -> None:
    """Compile what is translated, and compare the values, which are the same in C and C++."""
    chance = random.Random(1)
    pairs: list[tuple[str, str]] = []
    while len(pairs) < 600:
        cpp = grown(chance, chance.randrange(1, 5))
        python = translate_condition(cpp, VARIABLES)
        if python is not None:
            pairs.append((cpp, python))
    lines = ["#include <stdbool.h>", "#include <stdio.h>"]
    lines += [f"static volatile {TYPES[n]} {n} = {v!r};".lower() for n, v in VALUES.items()]
    lines += ["int main(void) {"]
    lines += [f'puts(({cpp}) ? "1" : "0");' for cpp, _ in pairs]
    source, program = tmp_path / "all.c", tmp_path / "all"
    source.write_text("\n".join([*lines, "}"]))
    subprocess.run(["cc", "-std=c11", "-w", "-O0", "-o", program, source], check=True)
    done = subprocess.run([program], check=True, text=True, capture_output=True)
    for (cpp, python), printed in zip(pairs, done.stdout.split(), strict=True):
        value = eval(python, {}, dict(VALUES))
        assert value is (printed == "1"), f"{cpp}  =>  {python}"
