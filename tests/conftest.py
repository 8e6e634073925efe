"""What all tests need of the process that runs them."""

import atexit
import gc
import logging
import os
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from calling import modules_forgotten
from costs import Costs
from second_try import SecondTry
from thoroughness import SEARCHING, examples
from workers import Workers

HIDDEN = hasattr(sys.modules.get("sitecustomize"), "EXTENSIONS")  # see without_extensions
REFUSED: list[BaseException] = []  # the errors of tests that were refused shared memory
SIGNALS = (signal.SIGINT, signal.SIGTERM)

# How long an example takes depends on what else the machine does.
settings.register_profile(
    "llfsm",
    max_examples=examples(30),
    derandomize=not SEARCHING,  # whether a change may land must not depend on luck
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("llfsm")


def pytest_configure(config: pytest.Config) -> None:
    """Take SIGINT as a terminal's program does, also when a shell's background job runs us.

    There it is ignored, and every process that a test starts would inherit that.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    gc.disable()
    if path := os.environ.get("LLFSM_COSTS"):
        config.pluginmanager.register(Costs(Path(path)))
    if "LLFSM_SECOND_TRY" in os.environ:
        config.pluginmanager.register(SecondTry())
    if "LLFSM_WORKERS" in os.environ:
        config.pluginmanager.register(Workers(int(os.environ.pop("LLFSM_WORKERS")), _note_refusals))
    else:
        _note_refusals()


def _note_refusals() -> None:
    """Make the file in which the processes of tests note that they were refused shared memory."""
    if HIDDEN:
        handle, os.environ["LLFSM_REFUSALS"] = tempfile.mkstemp(prefix="llfsm-refusals-")
        os.close(handle)
        atexit.register(os.unlink, os.environ["LLFSM_REFUSALS"])


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is for `make soak`. Begin with the files whose tests may take longest."""
    if "LLFSM_SOAK" not in os.environ:
        soaked = [item for item in items if item.get_closest_marker("soak")]
        config.hook.pytest_deselected(items=soaked)
        items[:] = [item for item in items if item not in soaked]
    long = {item.path for item in items if item.get_closest_marker("timeout")}
    items.sort(key=lambda item: item.path not in long)


def pytest_collection_finish() -> None:
    """Leave all that was collected out of the garbage collections of tests."""
    gc.collect()
    gc.freeze()
    gc.enable()


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print in a line for each reason how many tests were skipped."""
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in skipped)
    for reason, number in reasons.most_common():
        terminalreporter.write_line(f"{number} skipped: {reason}", yellow=True)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol() -> Iterator[Any]:
    """Forget what the test before was refused."""
    if HIDDEN:
        Path(os.environ["LLFSM_REFUSALS"]).write_bytes(b"")
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[Any]) -> Iterator[Any]:
    """Count a test as skipped if it, or a process of it, lacks the shared memory that is hidden."""
    report = yield
    if HIDDEN and report.failed and call.excinfo is not None and _was_refused(call.excinfo.value):
        report.outcome = "skipped"
        report.longrepr = (str(item.path), 0, "Skipped: it needs shared memory, which is hidden")
    return report


def _was_refused(error: BaseException) -> bool:
    """Whether a refusal is noted: now, or when a fixture failed that several tests have."""
    if Path(os.environ["LLFSM_REFUSALS"]).stat().st_size > 0:
        REFUSED.append(error)
    return any(error is each for each in REFUSED)


@pytest.fixture(autouse=True)
def _signals_and_log() -> Iterator[None]:
    """Give back what a command called in this process, not in its own, has taken or set."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    log = logging.getLogger("llfsm.runtime")
    level = log.level
    yield
    log.setLevel(level)
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def here(tmp_path: Path) -> Iterator[Path]:
    """An empty current folder; the modules that a test imports are forgotten."""
    with chdir(tmp_path), modules_forgotten():
        yield tmp_path
