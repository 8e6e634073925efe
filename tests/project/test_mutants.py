"""The mutants of `make mutants`: each changes one place, and is found where functions move."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from .rules import script

CODE = '''
class Oven:
    """A microwave."""

    def cook(self, minutes: int) -> bool:
        """Cook."""
        if minutes > 0 and not self.is_open:
            self.light = "on"
            self.left += minutes * 60
        return self.left == 0
'''
LATER = '''
"""Some other module."""
def other(self):
    if minutes > 0 or not self.is_open:
        return self.left == 1

class Oven:
    def cook(self, minutes: float) -> "bool":
        """Cook for so many minutes."""
        if minutes > 0 and not self.is_open:
            self.light = "on"
            self.left += minutes * 60
        return self.left == 0
'''


@pytest.fixture(scope="module")
def changes() -> Iterator[ModuleType]:
    with script("mutation/changes.py") as changes:
        yield changes


def product(changes: ModuleType, root: Path, path: str, code: str) -> list:  # type: ignore[type-arg]
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(code)
    return changes.functions(root)  # type: ignore[no-any-return]


def test_each_mutant_changes_one_place(changes: ModuleType, tmp_path: Path) -> None:
    functions = product(changes, tmp_path, "machines/oven.py", CODE)
    drawn = changes.draw(functions, 11, seed=1)
    assert len({str(each) for each in drawn}) == 11
    assert {each.kind for each in drawn} == {*changes.KINDS}
    texts = {changes.mutated(CODE, changes.find(each, functions)[1]) for each in drawn}
    assert len(texts) == 11
    for text in texts:
        assert ast.dump(ast.parse(text)) != ast.dump(ast.parse(CODE))
        assert len(text.splitlines()) == len(CODE.splitlines())


def test_the_draw_is_the_same_each_time(changes: ModuleType, tmp_path: Path) -> None:
    functions = product(changes, tmp_path, "machines/oven.py", CODE)
    assert changes.draw(functions, 6, seed=1) == changes.draw(functions, 6, seed=1)
    assert changes.draw(functions, 6, seed=1) != changes.draw(functions, 6, seed=2)


def test_a_mutant_is_found_where_its_function_went(changes: ModuleType, tmp_path: Path) -> None:
    """With other types and documents, too, though another function is alike."""
    before = product(changes, tmp_path / "before", "machines/oven.py", CODE)
    after = product(changes, tmp_path / "after", "bridges/kitchen/stove.py", LATER)
    for mutant in changes.draw(before, 11, seed=1):
        function, site = changes.find(mutant, after)
        assert function.name == "Oven.cook"
        assert ast.unparse(site.changed) == mutant.after


def test_a_statement_tells_the_place_in_a_changed_function(
    changes: ModuleType, tmp_path: Path
) -> None:
    before = product(changes, tmp_path / "before", "machines/oven.py", CODE)
    later = CODE.replace('self.light = "on"', "pass")
    after = product(changes, tmp_path / "after", "machines/oven.py", later)
    found = {str(each): changes.find(each, after) for each in changes.draw(before, 11, seed=1)}
    gone = {name for name, place in found.items() if place is None}
    assert gone == {name for name in found if "light" in name}
    assert 0 < len(gone) < 6
