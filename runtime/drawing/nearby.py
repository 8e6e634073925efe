"""What is near a place of a drawing: a grid, so that things are compared with neighbours only."""

from __future__ import annotations

from collections.abc import Iterator
from math import floor
from typing import Generic, TypeVar

__all__ = ["Grid"]

_CELL = 64.0
_MOST = 4096.0  # half the width and height of what is in cells, and looked for in them
_FAR = 1e12  # beyond, the cells cannot be numbered exactly

Item = TypeVar("Item")


class Grid(Generic[Item]):
    """Items with a width and a height around their centres, found by where they are."""

    def __init__(self) -> None:
        self._items: list[Item] = []
        self._cells: dict[tuple[int, int], list[int]] = {}
        self._anywhere: list[int] = []  # what is too large for cells, or without a place

    def add(self, item: Item, x: float, y: float, width: float = 0.0, height: float = 0.0) -> None:
        """Add an item."""
        number = len(self._items)
        self._items.append(item)
        if _fits(x, y, width, height):
            for cell in _cells(x, y, width, height):
                self._cells.setdefault(cell, []).append(number)
        else:
            self._anywhere.append(number)

    def near(self, x: float, y: float, width: float = 0.0, height: float = 0.0) -> list[Item]:
        """Return all items that overlap a rectangle, and a few more, in the order of adding."""
        if not _fits(x, y, width, height):
            return list(self._items)
        found = set(self._anywhere)
        for cell in _cells(x, y, width, height):
            found.update(self._cells.get(cell, ()))
        return [self._items[number] for number in sorted(found)]


def _fits(x: float, y: float, width: float, height: float) -> bool:
    """Return whether a rectangle has few cells; one that is not finite has none."""
    return abs(x) + abs(y) < _FAR and width < 2 * _MOST and height < 2 * _MOST


def _cells(x: float, y: float, width: float, height: float) -> Iterator[tuple[int, int]]:
    columns = range(floor((x - width / 2) / _CELL), floor((x + width / 2) / _CELL) + 1)
    rows = range(floor((y - height / 2) / _CELL), floor((y + height / 2) / _CELL) + 1)
    return ((column, row) for column in columns for row in rows)
