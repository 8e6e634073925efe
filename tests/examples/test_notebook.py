"""The notebook's cells run in order, and what it shows is a picture or a table."""

from __future__ import annotations

import ast
import json
import linecache
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).parents[2] / "examples" / "robot.ipynb"


def shown(cells: list[dict[str, Any]]) -> dict[str, object]:
    """Execute the cells of code as a notebook does; return the value of each by its id."""
    names: dict[str, Any] = {"__name__": "__main__"}
    values = {}
    for cell in cells:
        if cell["cell_type"] != "code":
            continue
        file, source = f"<cell {cell['id']}>", "".join(cell["source"])
        linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)
        tree = ast.parse(source)
        value = None
        if isinstance(tree.body[-1], ast.Expr):
            last = ast.Expression(tree.body.pop().value)  # type: ignore[attr-defined]
            exec(compile(tree, file, "exec"), names)
            value = eval(compile(last, file, "eval"), names)
        else:
            exec(compile(tree, file, "exec"), names)
        values[cell["id"]] = value
    return values


def table(value: Any) -> list[list[str]]:
    rows = ET.fromstring(value._repr_html_())
    return [["".join(cell.itertext()) for cell in row] for row in rows]


def test_the_notebook_runs_and_shows_what_it_says() -> None:
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    assert not any(cell.get("outputs") for cell in cells)  # they would grow old
    values: dict[str, Any] = shown(cells)
    assert table(values["table"]) == [
        ["state", "transition", "to"],
        ["patrolling", "is_low", "charging"],
        ["charging", "is_full", "patrolling"],
    ]
    machine, *rest = table(values["run"])[1:]
    assert (machine[0], machine[2], machine[3], rest) == ("Patrol", "running", "120", [])
    slots = table(values["board"])[1:]
    assert [slot[0] for slot in slots] == ["battery", "drive"]
    assert json.loads(slots[0][3])["percent"] > 20
    for picture in ("diagram", "timeline"):
        ET.fromstring(values[picture]._repr_svg_())
    assert {stay.state for stay in values["timeline"]} == {"patrolling", "charging"}
