"""What each test costs: a plugin that lists the hundred which take most of a processor.

`make slowest` runs all tests with it. A test's cost is the processor time that its process spent
from the test's beginning to its end, and that of the processes which it ended: unlike the time on a
clock, it is nearly the same on a busy machine. What several tests share is counted to the first.
"""

from __future__ import annotations

import json
import resource
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

__all__ = ["Costs"]

_SHOWN = 100
_Cost = tuple[float, float]  # seconds: of a processor, on the clock


class Costs:
    """Take what tests cost, print it, and store it as JSON in a file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._begun: dict[str, _Cost] = {}
        self._costs: dict[str, _Cost] = {}

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Take the times at a test's beginning."""
        self._begun[nodeid] = _now()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Iterator[Any]:
        """Add a test's cost to its last report, which a worker hands over."""
        report = yield
        if report.when == "teardown":
            begun = self._begun[item.nodeid]
            report.cost = [now - then for now, then in zip(_now(), begun, strict=True)]
        return report

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Collect the costs."""
        if hasattr(report, "cost"):
            self._costs[report.nodeid] = report.cost[0], report.cost[1]

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Print the costliest tests, the costliest files, and the sum."""
        self._path.write_text(json.dumps(self._costs, indent=0))
        files = defaultdict(list)
        for name, cost in self._costs.items():
            files[name.partition("::")[0]].append(cost)
        by_file = {name: _sum(costs) for name, costs in files.items()}
        terminalreporter.section("seconds of a processor, and on the clock")
        for costs in (self._costs, by_file, {"all tests": _sum([*self._costs.values()])}):
            for name, (processor_s, clock_s) in sorted(costs.items(), key=lambda each: -each[1][0])[
                :_SHOWN
            ]:
                terminalreporter.write_line(f"{processor_s:8.2f} {clock_s:8.2f}  {name}")
            terminalreporter.write_line("")


def _now() -> _Cost:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used), time.monotonic()


def _sum(costs: list[_Cost]) -> _Cost:
    return sum(each[0] for each in costs), sum(each[1] for each in costs)
