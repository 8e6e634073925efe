"""Which tests enter which function of the product: a copy of the sources notes it as it runs.

`instrument` puts a call at the head of each function, which costs far less than a hook of Python
that sees each call. Loaded by pytest (`-p entered`), this module also tells the copy which test
runs, in this process and in those that it starts, and keeps what each test took.
"""

from __future__ import annotations

import ast
import importlib
import json
import os
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from changes import Function, functions

VARIABLE = "LLFSM_ENTERED"  # the folder of what is noted
TEST = "LLFSM_ENTERED_BY"  # the test that runs, whose processes inherit it
NOTING = '''"""Note the functions that are entered."""
import os
seen = bytearray({count})
def enter(number):
    if not seen[number]:
        seen[number] = 1
        folder = os.environ.get("{variable}")
        if folder:
            line = f"{{number}} {{os.environ.get('{test}', '')}}\\n".encode()
            file = os.open(folder + "/" + str(os.getpid()), os.O_WRONLY | os.O_APPEND | os.O_CREAT)
            os.write(file, line)
            os.close(file)
def forget():
    seen[:] = bytes(len(seen))
os.register_at_fork(after_in_child=forget)
'''


def instrument(root: Path) -> list[Function]:
    """Change the sources of a checkout so that they note what is entered; list their functions."""
    found = functions(root)
    by_path = defaultdict(list)
    for number, function in enumerate(found):
        by_path[function.path].append((number, function))
    for path, inside in by_path.items():
        lines = path.read_text().splitlines(keepends=True)
        for number, function in sorted(inside, key=lambda each: -_first(each[1]).lineno):
            first, call = _first(function), f"_enter({number})"
            line = lines[first.lineno - 1].encode()
            before, rest = line[: first.col_offset].decode(), line[first.col_offset :].decode()
            if isinstance(first, ast.Expr) and isinstance(
                first.value, ast.Constant | ast.JoinedStr
            ):
                end = first.end_lineno or first.lineno  # a docstring, or `...`, alone
                if before.strip():
                    lines[end - 1] = lines[end - 1].rstrip("\n") + f"; {call}\n"
                else:
                    lines.insert(end, f"{before}{call}\n")
            elif before.strip():
                lines[first.lineno - 1] = f"{before}{call}; {rest}"
            else:
                start = min(
                    [first.lineno, *(d.lineno for d in getattr(first, "decorator_list", ()))]
                )
                lines.insert(start - 1, f"{before}{call}\n")
        body = ast.parse(path.read_text()).body
        ends = [
            each.end_lineno or 0
            for n, each in enumerate(body)
            if (n == 0 and isinstance(each, ast.Expr))
            or (isinstance(each, ast.ImportFrom) and each.module == "__future__")
        ]
        lines.insert(max(ends, default=0), "from llfsm._entered import enter as _enter\n")
        path.write_text("".join(lines))
    noting = NOTING.format(count=len(found), variable=VARIABLE, test=TEST)
    (root / "src" / "llfsm" / "_entered.py").write_text(noting)
    return found


def _first(function: Function) -> ast.stmt:
    """Return the first statement after the docstring, or that if there is no other."""
    body = function.node.body
    return body[1] if len(body) > 1 and ast.get_docstring(function.node) is not None else body[0]


def gathered(folder: Path, found: list[Function]) -> dict[str, list[str]]:
    """List the tests that have entered each function, by its key; a file stands for its tests."""
    tests = defaultdict(set)
    for path in folder.iterdir():
        if path.name.isdecimal():
            for line in path.read_text().splitlines():
                number, _, test = line.partition(" ")
                tests[found[int(number)].key].add(test)
    return {key: sorted(each) for key, each in sorted(tests.items())}


def seconds(folder: Path) -> dict[str, float]:
    """Return what each test took, also those that failed, which are in `failed`."""
    taken: dict[str, float] = {}
    for path in folder.glob("taken-*"):
        for line in path.read_text().splitlines():
            test, took = json.loads(line)
            taken[test] = took
    return taken


def failed(folder: Path) -> list[str]:
    """List the tests that failed."""
    return sorted(
        line for path in folder.glob("failed-*") for line in path.read_text().splitlines()
    )


# ---- The plugin of pytest


def _begin(test: str) -> None:
    os.environ[TEST] = test
    importlib.import_module("llfsm._entered").forget()


def pytest_collection_finish() -> None:
    """What is imported from now on is entered by the test that runs."""
    if VARIABLE in os.environ:
        _begin("")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[Any]:
    """Keep what a test took, and note by what file its fixtures were made, which others share."""
    folder = os.environ.get(VARIABLE)
    if not folder:
        return (yield)
    _begin(item.nodeid.partition("::")[0])
    begin = time.monotonic()
    try:
        return (yield)
    finally:
        _append(folder, "taken", json.dumps([item.nodeid, round(time.monotonic() - begin, 3)]))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[Any]:
    """Note what the test itself enters."""
    if VARIABLE in os.environ:
        _begin(item.nodeid.replace("\n", " "))
    return (yield)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Keep which tests failed."""
    folder = os.environ.get(VARIABLE)
    if folder and report.failed and not hasattr(report, "node"):  # which a worker's has, again
        _append(folder, "failed", report.nodeid)


def _append(folder: str, what: str, line: str) -> None:
    with Path(folder, f"{what}-{os.getpid()}").open("a") as file:
        file.write(line + "\n")
