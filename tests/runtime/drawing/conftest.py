"""Machines to draw: of any shape, with hostile names and labels."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from hypothesis import strategies as st

from llfsm.runtime import Machine, State, UnreachableStateWarning, define

HOSTILE = (
    "end", "node", "state", "graph", "end note", "classDef", "[*]", "direction LR", "s0", "start",
    'a"b', "back\\slash\\", "\\N\\l", "two\nlines", "x;y:z", "#35;", "<b>&amp;</b>", "]]>",
    "%%{x}%%", "-->", "<!--", "ünïcödé", "日本語", "e\u0301", "\x00\x1b", "\ud800", "tab\there",
    " ", "a  b",
    "style: #x;", "$$x$$", "`*m*`", "{", "}", "'",
    "self.battery.voltage < 11.1 and self.pose.x > 2",
    "a" * 90, "\u2028", "\u202e", "\ufffe",
)  # fmt: skip

texts = st.sampled_from(HOSTILE) | st.text(max_size=60)
"""Labels of transitions."""

names = texts.filter(bool)
"""Names of states."""


def machine(
    arcs: Sequence[tuple[int, int, str]],
    names: Sequence[str],
    suspend: int | None = None,
) -> type[Machine]:
    """Define a machine of states by number, with a transition for each arc."""
    states = [State(name, suspend=i == suspend) for i, name in enumerate(names)]
    for source, target, label in arcs:
        states[source].to(states[target], when=lambda _: True, label=label)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnreachableStateWarning)
        return define("Drawn", states)


@st.composite
def machines(draw: st.DrawFn, labels: st.SearchStrategy[str] = texts) -> type[Machine]:
    named = draw(st.lists(names, min_size=1, max_size=9, unique=True))
    some = st.integers(0, len(named) - 1)
    arcs = draw(st.lists(st.tuples(some, some, labels), max_size=20))
    return machine(arcs, named, draw(st.none() | some))
