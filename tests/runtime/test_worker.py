"""Methods of an object in another process are called, whatever its code does there."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from llfsm.errors import LlfsmError
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.worker import Worker, WorkerError, sendable

PATIENCE_S = 60.0


@pytest.fixture
def call() -> Iterator[Callable[..., Any]]:
    """Yield what evaluates an expression in a worker."""
    with Worker("the code") as worker:
        worker.make(__import__, "builtins", patience_s=PATIENCE_S)

        def call(name: str, *arguments: Any, patience_s: float = PATIENCE_S) -> Any:
            return worker.call(name, *arguments, patience_s=patience_s)

        yield call


def test_what_a_method_returns_comes_back(call: Callable[..., Any]) -> None:
    assert call("divmod", 7, 2) == (3, 1)
    assert call("iter", [1, 2]) == [1, 2], "of an iterator, a list"
    assert call("eval", "__import__('os').getpid()") != os.getpid()


def test_an_error_is_raised_here(call: Callable[..., Any]) -> None:
    with pytest.raises(FileNotFoundError):
        call("open", "/nowhere")
    code = (
        "from llfsm.runtime.engine.errors import BundleError\nraise BundleError('wrong', 'file', 3)"
    )
    with pytest.raises(BundleError, match="file:3: wrong"):
        call("exec", code)
    assert call("abs", -1) == 1, "and the worker goes on"


def test_what_code_prints_is_no_answer_and_it_has_no_input(call: Callable[..., Any]) -> None:
    assert call("print", "noise") is None
    assert call("eval", "__import__('sys').stdin.read()") == ""


@pytest.mark.parametrize(
    ("code", "patience_s", "why"),
    [
        ("while True: pass", 0.2, "the code does not return for 0.2 s"),
        ("__import__('os')._exit(0)", PATIENCE_S, "the code has ended its process"),
    ],
)
def test_code_that_hangs_or_ends_its_process_is_an_error(
    call: Callable[..., Any], code: str, patience_s: float, why: str
) -> None:
    for _ in range(2):
        with pytest.raises(WorkerError, match=f"^{why}$"):
            call("exec", code, patience_s=patience_s)


def test_a_call_ends_when_another_thread_kills_the_process() -> None:
    with Worker("the code") as worker:
        worker.make(__import__, "builtins", patience_s=PATIENCE_S)
        threading.Timer(0.1, worker.kill).start()
        with pytest.raises(WorkerError, match="has ended its process"):
            worker.call("exec", "while True: pass", patience_s=PATIENCE_S)
        assert worker.has_ended


class OddError(LlfsmError):
    def __init__(self, one: int, two: int):
        super().__init__(f"{one} and {two}")


def test_an_error_that_cannot_be_made_again_is_sent_as_its_text() -> None:
    assert type(sendable(BundleError("wrong"))) is BundleError
    assert str(sendable(OddError(1, 2))) == "1 and 2"
    assert type(sendable(OddError(1, 2))) is LlfsmError
