"""The figures of the page of comparisons are those of one run of the benchmark."""

from __future__ import annotations

import json

from .rules import script


def test_the_page_has_the_figures_of_the_run_that_is_kept() -> None:
    with script("figures.py") as figures:
        run = json.loads(figures.RUN.read_text())
        assert not run["quick"]
        assert run["missing"] == []
        assert figures.page(run) == figures.PAGE.read_text()
