"""Each promise of the documents is broken by a change, for which `make mutants` runs its tests."""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType

import pytest

from .rules import ROOT, script


@pytest.fixture(scope="module")
def promises() -> Iterator[ModuleType]:
    with script("promises.py") as promises:
        yield promises


def test_what_survived_once_is_still_to_be_found(promises: ModuleType) -> None:
    for change in promises.broken("survivors.toml"):
        assert change.text(ROOT) != (ROOT / change.file).read_text()
        assert all((ROOT / test).exists() for test in change.promise.tests)


@pytest.mark.parametrize("name", ["guarantees.toml", "security.toml"])
def test_each_promise_has_tests_and_a_change_that_breaks_it(
    promises: ModuleType, name: str
) -> None:
    of_page = [*promises.promises(promises.PAGES[name])]
    assert len(of_page) > 15
    for promise in of_page:
        assert promise.tests, promise.text
        for test in promise.tests:
            assert (ROOT / test).exists(), test
    changes = [*promises.broken(name)]
    for change in changes:
        assert change.text(ROOT) != (ROOT / change.file).read_text()
    broken = {change.promise.text for change in changes}
    assert [each.text for each in of_page if each.text not in broken] == []
