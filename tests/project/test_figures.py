"""The figures of the page of comparisons are those of one run of the benchmark."""

from __future__ import annotations

import importlib.util
import json

from .rules import ROOT


def test_the_page_has_the_figures_of_the_run_that_is_kept() -> None:
    spec = importlib.util.spec_from_file_location("figures", ROOT / ".ci" / "figures.py")
    assert spec
    assert spec.loader
    figures = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(figures)
    run = json.loads(figures.RUN.read_text())
    assert not run["quick"]
    assert run["missing"] == []
    assert figures.page(run) == figures.PAGE.read_text()
