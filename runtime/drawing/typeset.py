"""The words of a picture: the lines of labels and sections, and about how wide each line is.

Widths are estimated from a table of Helvetica's, as no renderer is asked: a diagram has the same
places wherever it is made.
"""

from __future__ import annotations

import re
import textwrap
import unicodedata
from collections.abc import Iterable
from typing import Final, NamedTuple

from llfsm.runtime.engine.source_text import body_of
from llfsm.runtime.engine.state import SECTIONS, State
from llfsm.runtime.engine.table import run_names

_TAB = 4
_CHARACTERS = 34  # of a line of a label, before it is broken

# Widths of Helvetica in thousandths of the font's size
_WIDTHS = {
    character: width
    for width, characters in {
        222: "ijl'",
        278: "ftI!/\\[] .,:;|",
        355: 'r()-{}`"*',
        500: "ckJsvxyz^",
        556: "abdeghnopqu_L0123456789#$?",
        611: "FTZ<>=+~",
        667: "ABEKPSVXY&",
        722: "CDHNRUw",
        778: "GOQ",
        833: "mM",
        960: "W%@",
    }.items()
    for character in characters
}
_NOT_SHOWN = re.compile("[^\n\x20-\x7e\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class SectionText(NamedTuple):
    """A section of a state and its source text; no lines if the source cannot be read."""

    name: str
    lines: tuple[str, ...]


def printable(text: str) -> str:
    """Replace what no format can hold, such as control characters, and expand tabs."""
    return _NOT_SHOWN.sub("\ufffd", re.sub("\r\n?", "\n", text).expandtabs(_TAB))


def text_width(text: str, size: float) -> float:
    """Estimate the width of a line of proportional text of a size."""
    return sum(_WIDTHS.get(c) or _wide(c) * 620 for c in text) * size / 1000


def code_width(text: str, size: float) -> float:
    """Estimate the width of a line of monospaced text of a size."""
    return sum(_wide(c) for c in text) * 0.602 * size


def _wide(character: str) -> float:
    if unicodedata.combining(character):
        return 0
    return 1.7 if unicodedata.east_asian_width(character) in "WF" else 1


def line_height(size: float) -> float:
    """Return the distance of two lines of text of a size."""
    return size * 1.35


def wrap(text: str) -> tuple[str, ...]:
    """Break text into short lines, between words where it can."""
    lines = []
    for line in printable(text).split("\n"):
        lines += textwrap.wrap(line, _CHARACTERS, break_on_hyphens=False) or [""]
    return tuple(lines)


def numbered_labels(state: State) -> list[str]:
    """List the labels of a state's transitions, numbered from 1 if there are several."""
    labels = [transition.label for transition in state.transitions]
    if len(labels) < 2:
        return labels
    return [f"{number}: {label}" for number, label in enumerate(labels, 1)]


RUNS: Final = "runs"
"""The heading of what a state runs."""


def section_texts(
    state: State, *, sections: bool = True, runs: Iterable[str] | None = None
) -> tuple[SectionText, ...]:
    """List what a state `runs`, by default all, and, unless only that is wanted, its sections.

    They are in the fixed order of sections, with their code.
    """
    names = [*(run_names(state) if runs is None else runs)]
    first = (SectionText(RUNS, tuple(names)),) if names else ()
    if not sections:
        return first
    return first + tuple(
        SectionText(name, text_lines(body_of(state.sections[name]) or ""))
        for name in SECTIONS
        if name in state.sections
    )


def text_lines(text: str) -> tuple[str, ...]:
    """Split code into lines, without blank ones around it; none if all are blank."""
    lines = [line.rstrip() for line in printable(text).split("\n")]
    return tuple("\n".join(lines).strip("\n").split("\n")) if any(lines) else ()
