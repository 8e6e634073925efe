"""A second try for a test that failed, which the summary names: a plugin for `.ci/run`.

pytest-rerunfailures does this, too, but with workers it takes 10 ms a test.
"""

from __future__ import annotations

import pytest
from _pytest.runner import runtestprotocol

__all__ = ["SecondTry"]


class SecondTry:
    """Run a test that failed once more, with new fixtures and a time limit of its own."""

    def __init__(self) -> None:
        self._again: pytest.Item | None = None  # that is tried once more
        self._reports: list[pytest.TestReport] = []

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        """Run a test, and log what came of its last try; that it failed before is an outcome."""
        if item is self._again:
            self._reports = runtestprotocol(item, nextitem=nextitem, log=False)
            return True
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        failed = [report for report in reports if report.failed]
        if failed:
            failed[0].outcome = "rerun"
            item.ihook.pytest_runtest_logreport(report=failed[0])
            item._initrequest()  # pytest's own, for want of another way to make fixtures anew
            self._again = item
            item.ihook.pytest_runtest_protocol(item=item, nextitem=nextitem)  # whoever wraps it
            self._again, reports = None, self._reports
        for report in reports:
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def pytest_report_teststatus(
        self, report: pytest.TestReport
    ) -> tuple[str, str, tuple[str, dict[str, bool]]] | None:
        """Count a first try that failed as such."""
        return ("rerun", "R", ("RERUN", {"yellow": True})) if report.outcome == "rerun" else None

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Name the tests that failed once, and why."""
        for report in terminalreporter.stats.get("rerun", ()):
            terminalreporter.section(f"first try of {report.nodeid}")
            terminalreporter.line(report.longreprtext)
