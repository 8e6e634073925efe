"""A plugin of pytest: run the tests that a file names, in its order."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

ORDER = "LLFSM_MUTANTS_ORDER"  # names the file: a list, in JSON, of tests and of files of tests


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the tests that are named, or whose files are; in their order."""
    if ORDER not in os.environ:
        return
    places = {name: n for n, name in enumerate(json.loads(Path(os.environ[ORDER]).read_text()))}
    by_place = {}
    for item in items:
        place = places.get(item.nodeid, places.get(item.nodeid.partition("::")[0]))
        if place is not None:
            by_place[item.nodeid] = place
    kept = sorted((each for each in items if each.nodeid in by_place),
                  key=lambda each: by_place[each.nodeid])  # fmt: skip
    config.hook.pytest_deselected(items=[each for each in items if each.nodeid not in by_place])
    items[:] = kept
