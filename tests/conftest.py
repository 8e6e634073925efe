"""What all tests need of the process that runs them."""

import gc
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

HIDDEN = sys.modules.get("llfsm.whiteboard._shm", ...) is None
SIGNALS = (signal.SIGINT, signal.SIGTERM)

# How long an example takes depends on what else the machine does.
settings.register_profile("llfsm", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("llfsm")


def pytest_configure() -> None:
    """Take SIGINT as a terminal's program does, also when a shell's background job runs us.

    There it is ignored, and every process that a test starts would inherit that.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files whose tests may take longest, so that no worker ends with one alone."""
    long = {item.path for item in items if item.get_closest_marker("timeout")}
    items.sort(key=lambda item: item.path not in long)


def pytest_collection_finish() -> None:
    """Leave all that was collected out of the garbage collections of tests."""
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print in a line for each reason how many tests were skipped."""
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in skipped)
    for reason, number in reasons.most_common():
        terminalreporter.write_line(f"{number} skipped: {reason}", yellow=True)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[Any]:
    """Count a test as skipped if it, or a process of it, lacks the shared memory that is hidden."""
    report = yield
    if HIDDEN and report.failed and "SharedMemoryUnavailableError" in str(report.longrepr):
        report.outcome = "skipped"
        report.longrepr = (str(item.path), 0, "Skipped: it needs shared memory, which is hidden")
    return report


@pytest.fixture(autouse=True)
def _signal_handlers() -> Iterator[None]:
    """Give back the handlers that a command called in this process, not in its own, has taken."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty current folder; the modules that a test imports are forgotten."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    before = {*sys.modules}
    yield tmp_path
    for name in {*sys.modules} - before:
        del sys.modules[name]
