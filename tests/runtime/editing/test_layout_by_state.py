"""A layout whose states are read one by one is what it is when it is read as a whole."""

from __future__ import annotations

import plistlib
from pathlib import Path
from typing import Any
from xml.parsers import expat

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime.bundles import plist
from llfsm.runtime.editing import _layout_edits as property_list
from llfsm.runtime.editing._layout_edits import PropertyList
from llfsm.runtime.editing.errors import EditError
from llfsm.runtime.engine.errors import BundleError

HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<plist version="1.0">\n<dict>\n\t<key>States</key>\n'
)
A = (
    "\n\t\t<key>A</key>\n\t\t<dict>\n\t\t\t<key>x</key><real>1</real>"
    "\n\t\t\t<key>y</key><real>2</real>\n\t\t</dict>"
)
END = "\n\t</dict>\n</dict>\n</plist>\n"
PIECES = [
    A,
    A.replace(">A<", ">B<").replace("1<", "3<"),
    A.replace("<key>y</key><real>2</real>", "<key>w</key><real>9</real>"),
    A.replace(">A<", ">&#65;<"),
    "\n\t\t<key>C</key>\n\t\t<string>no dictionary</string>",
    "\n\t\t<key>D</key>",
    "<!-- ", " -->", "<![CDATA[", "]]>",
    "\n\t</dict>\n\t<key>Other</key>\n\t<dict>",
    "\n\t<key>States</key>\n\t<dict>",
    "<dict>", "</dict>", "\n\t\t",
]  # fmt: skip
texts = st.lists(st.sampled_from(PIECES), max_size=5).map(
    lambda pieces: (HEAD + "\t<dict>" + "".join(pieces) + END).encode()
)


def read(data: bytes) -> Any:
    try:
        return plist.read_layout(data, Path("Layout.plist"))
    except BundleError as error:
        return str(error)


def edited(data: bytes) -> list[bytes | str]:
    """Make each change of one value."""
    results: list[bytes | str] = []
    for change, *arguments in (
        ("set", ("States", "A", "x"), 7),
        ("set", ("States", "A", "new"), 7),
        ("set", ("States", "E"), {"x": 1}),
        ("set", ("Version",), "1"),
        ("rename", ("States", "A"), "F"),
        ("remove", "States", "A"),
    ):
        text = PropertyList(data)
        try:
            getattr(text, change)(*arguments)
            results.append(text.data)
        except (EditError, KeyError) as error:
            results.append(repr(error))
    return results


def compare(data: bytes) -> None:
    found = read(data)
    can_edit = not isinstance(found, str) and isinstance(plistlib.loads(data).get("States"), dict)
    made = edited(data) if can_edit else None
    with pytest.MonkeyPatch.context() as patch:
        for module in (plist, property_list):
            patch.setattr(module, "split_states", lambda _: None)
        assert found == read(data)
        if made is not None:
            assert made == edited(data)


@given(texts)
def test_by_state_and_as_a_whole(data: bytes) -> None:
    compare(data)


NESTED = "\t<dict/>\n\t<key>X</key><dict><key>States</key><dict>" + A + "\n\t</dict></dict>"


@pytest.mark.parametrize(
    "text",
    [
        HEAD + "\t<dict>" + A * 2 + END,
        HEAD.replace("UTF-8", "latin-1") + "\t<dict>" + A.replace("A", "\xc3\xa4") + END,
        HEAD + "\t<dict/>\n\t<key>Others</key>\n\t<dict>" + A + END,
        HEAD + NESTED + "</dict></plist>",
        HEAD.replace("States", "Stat&#101;s") + NESTED + "</dict></plist>",
        HEAD.replace("<key>", "<key >")
        + "\t<dict/><!-- <key>States</key><dict>" + A + "\n\t</dict>--></dict></plist>",
    ],
)  # fmt: skip
def test_what_only_looks_as_editors_write_it(text: str) -> None:
    compare(text.encode("latin-1"))


class NotingParser:
    """A parser that notes what it parses."""

    def __init__(self, parser: Any, parsed: list[bytes]):
        vars(self).update(parser=parser, parsed=parsed)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.parser, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self.parser, name, value)

    def Parse(self, data: bytes, is_final: bool) -> int:  # noqa: N802  # its name in expat
        self.parsed.append(data)
        return int(self.parser.Parse(data, is_final))


def test_a_state_that_was_read_is_not_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    two = A + A.replace(">A<", ">B<")
    before = (HEAD + "\t<dict>" + two + END).encode()
    read(before)
    property_list.PropertyList(before)
    parsed: list[bytes] = []

    loads, create = plistlib.loads, expat.ParserCreate
    monkeypatch.setattr(plistlib, "loads", lambda data: [parsed.append(data), loads(data)][1])
    monkeypatch.setattr(expat, "ParserCreate", lambda: NotingParser(create(), parsed))
    after = before.replace(b"<real>1<", b"<real>5<", 1)
    assert read(after).states["A"].x == 5
    assert PropertyList(after).has("States", "B", "x")
    assert len(parsed) > 2
    assert not any(b"<key>B</key>" in text for text in parsed)
