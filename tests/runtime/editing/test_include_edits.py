"""Statements are included once, where they belong, and nothing else of the text changes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from llfsm.runtime.editing import Document, EditError, decode_edits

NEW = """\
from typing import Annotated
from typing import Literal
from llfsm.whiteboard import Message


class Point(Message):
    x: float = 0.0  # metres


LOW = 3
"""
IMPORTS = "from typing import Annotated, Literal\nfrom llfsm.whiteboard import Message\n"
CLASS = "\n\nclass Point(Message):\n    x: float = 0.0  # metres\n"


def include(folder: Path, text: str) -> str:
    Document(folder).apply(decode_edits(json.dumps([{"edit": "include", "text": text}])))
    return (folder / "M_Includes.py").read_bytes().decode()


@pytest.mark.parametrize(
    ("old", "made"),
    [
        ("", f"{IMPORTS}{CLASS}\n\nLOW = 3\n"),
        ('"""Doc.\n\nMore."""\n', f'"""Doc.\n\nMore."""\n\n{IMPORTS}{CLASS}\n\nLOW = 3\n'),
        ("# mine\nX = 1\n", f"{IMPORTS}\n# mine\nX = 1\n{CLASS}\n\nLOW = 3\n"),
        ("import os\n\nLOW = 3\n", f"import os\n{IMPORTS}\nLOW = 3\n{CLASS}"),
        (
            "from llfsm.whiteboard import (\n    Message,\n    Slot,\n)\n",
            "from llfsm.whiteboard import (\n    Message,\n    Slot,\n)\n"
            f"from typing import Annotated, Literal\n{CLASS}\n\nLOW = 3\n",
        ),
        ("from typing import (\n", f"from typing import (\n{IMPORTS}{CLASS}\n\nLOW = 3\n"),
    ],
)
def test_where_they_belong(confusing: Path, old: str, made: str) -> None:
    if old:
        (confusing / "M_Includes.py").write_text(old)
    assert include(confusing, NEW) == made
    if "from typing import (" not in old:
        assert include(confusing, NEW) == made


def test_a_text_and_what_it_includes_are_one_step(confusing: Path) -> None:
    (confusing / "M_Includes.py").write_bytes(b"import os\r\n")
    before = {path.name: path.read_bytes() for path in confusing.iterdir()}
    document = Document(confusing)
    place = {"part": "Variables"}
    text = {"edit": "set text", "place": place, "text": "x: int = 1\n"}
    was = "count: int = 0  # how many\n"
    edits = [text | {"was": was}, {"edit": "include", "text": "import sys\n"}]
    changed = document.apply(decode_edits(json.dumps(edits)))
    assert sorted(changed) == ["M_Includes.py", "M_Variables.py"]
    assert (confusing / "M_Includes.py").read_bytes() == b"import os\r\nimport sys\r\n"
    document.undo()
    assert {path.name: path.read_bytes() for path in confusing.iterdir()} == before


@pytest.mark.parametrize("text", ["import (", "x = \0", "(" * 500])
def test_what_is_no_python_is_not_included(confusing: Path, text: str) -> None:
    with pytest.raises(EditError, match="not included: "):
        include(confusing, text)
