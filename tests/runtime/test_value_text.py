"""A value is a text within bounds, and so is the work on it, whatever it is."""

from __future__ import annotations

import tracemalloc
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime.value_text import ValueText
from llfsm.whiteboard import Message

MOST = 80


class Size(Message):
    """A part of a message."""

    width: int = 0
    scale: float = 1.0


class Image(Message):
    """A large message."""

    size: Size = Size()
    rows: tuple[float, ...] = ()
    data: bytes = b""


class _Raises:
    def __repr__(self) -> str:
        raise RuntimeError("no")


class _NoText:
    def __repr__(self) -> str:
        return "\ud800"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "None"),
        (0.1 + 0.2, "0.30000000000000004"),
        ("it's", '"it\'s"'),
        ("\ud800", "'\\ud800'"),
        (Size(3, 0.1 + 0.2), "Size(width=3, scale=0.3)"),
        (Image(), "Image(size=Size(width=0, scale=1), rows=(), data=b'')"),
        (bytes(7), r"b'\x00\x00\x00\x00\x00\x00'… 7 bytes"),
        ([1, 2], "[1, 2]"),
        ([[[[[5]]]]], "[[[[[...]]]]]"),
        ([[[[Size()]]]], "[[[[Size(...)]]]]"),
        pytest.param(10**5000, "<an int of 16610 bits>", id="long"),
        (10**50, "100000000000000000...0000000000000000000"),
        (_NoText(), "(UnicodeEncodeError while it was described)"),
    ],
)
def test_a_value_is_as_in_python_but_for_what_is_left_out(value: Any, text: str) -> None:
    assert ValueText(MOST).text(value) == text


def test_of_an_image_only_the_first_bytes_are_looked_at() -> None:
    image = Image(rows=(1.0,) * 10_000, data=bytes(1_000_000))
    texts = ValueText(MOST)
    texts.text(image)
    tracemalloc.start()
    try:
        text = texts.text(image)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert text.startswith("Image(size=Size(width=0, scale=1), rows=(1, 1, 1, 1, 1, 1, ...)")
    assert peak < 10_000


values = st.recursive(
    st.none() | st.floats() | st.integers() | st.text() | st.binary() | st.builds(_Raises),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.tuples(inner, inner),
    max_leaves=20,
)


@given(values)
def test_no_value_exceeds_the_bound_or_raises(value: Any) -> None:
    text = ValueText(MOST).text(value)
    assert text.encode()
    assert len(text) <= MOST
