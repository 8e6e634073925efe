"""Boxes and labels that fit their text, and where each line of it stands.

The words of a picture: what is written where, in how many lines, and how wide that is.
"""

from __future__ import annotations

import re
import textwrap
import unicodedata
from collections.abc import Iterator

from llfsm.runtime.drawing import style
from llfsm.runtime.drawing.diagram import Box, Label, SectionText
from llfsm.runtime.drawing.shapes import Text
from llfsm.runtime.engine.source_text import body_of
from llfsm.runtime.engine.state import SECTIONS, State

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


def printable(text: str) -> str:
    """Replace what no format can hold, such as control characters, and expand tabs."""
    return _NOT_SHOWN.sub("\ufffd", re.sub("\r\n?", "\n", text).expandtabs(_TAB))


def text_width(text: str, size: float) -> float:
    """Return about how wide a line of proportional text is."""
    return sum(_WIDTHS.get(c) or _wide(c) * 620 for c in text) * size / 1000


def code_width(text: str, size: float) -> float:
    """Return how wide a line of monospaced text is."""
    return sum(_wide(c) for c in text) * 0.602 * size


def _wide(character: str) -> float:
    if unicodedata.combining(character):
        return 0
    return 1.7 if unicodedata.east_asian_width(character) in "WF" else 1


def line_height(size: float) -> float:
    """Return the distance of two lines."""
    return size * 1.35


def wrap(text: str) -> tuple[str, ...]:
    """Break text into short lines, between words where it can."""
    lines = []
    for line in printable(text).split("\n"):
        lines += textwrap.wrap(line, _CHARACTERS, break_on_hyphens=False) or [""]
    return tuple(lines)


def numbered_labels(state: State) -> list[str]:
    """Return the labels of a state's transitions, numbered from 1 if there are several."""
    labels = [transition.label for transition in state.transitions]
    if len(labels) < 2:
        return labels
    return [f"{number}: {label}" for number, label in enumerate(labels, 1)]


def section_texts(state: State) -> tuple[SectionText, ...]:
    """Return the sections that a state has, in the order in which they are always listed."""
    return tuple(
        SectionText(name, text_lines(body_of(state.sections[name]) or ""))
        for name in SECTIONS
        if name in state.sections
    )


def text_lines(text: str) -> tuple[str, ...]:
    """Return the lines of code, without blank ones around it; none if it is blank."""
    lines = [line.rstrip() for line in printable(text).split("\n")]
    return tuple("\n".join(lines).strip("\n").split("\n")) if any(lines) else ()


_PADDING = 12.0  # beside the text of a box
_ABOVE = 9.0  # above and below a title on its own
_ABOVE_SECTIONS = 7.0  # above a title with sections, and below these
_HEADING = 4.0 + line_height(style.HEADING_SIZE)
_CUT = " …"
_BASELINE = 0.35  # of a size below the middle of a line


def make_label(text: str) -> Label:
    """Return a label of some text, to be placed."""
    lines = wrap(text)
    width = max(text_width(line, style.LABEL_SIZE) for line in lines)
    return Label(0, 0, width + 8, len(lines) * line_height(style.LABEL_SIZE) + 2, lines)


def make_box(
    state: str,
    sections: tuple[SectionText, ...],
    *,
    initial: bool,
    accepting: bool,
    suspend: bool,
    width: float = 0,
    height: float = 0,
) -> Box:
    """Return the box of a state, to be placed: as large as asked, or as its text needs."""
    title = wrap(state)
    widths = [text_width(line, style.TITLE_SIZE) * style.BOLD for line in title]
    needed = _title_height(title) + 2 * (_ABOVE_SECTIONS if sections else _ABOVE)
    for section in sections:
        widths.append(text_width(section.name, style.HEADING_SIZE) * style.BOLD)
        widths += [code_width(line, style.CODE_SIZE) for line in section.lines]
        needed += _HEADING + len(section.lines) * line_height(style.CODE_SIZE)
    width, height = max(width, max(widths) + 2 * _PADDING), max(height, needed)
    return Box(state, 0, 0, width, height, title, sections, initial, accepting, suspend)


def cut_sections(
    state: str, sections: tuple[SectionText, ...], width: float, height: float
) -> tuple[SectionText, ...]:
    """Return what of a state's sections fits into a box; an ellipsis stands for the rest."""
    letters = max(int((width - 2 * _PADDING) / code_width("m", style.CODE_SIZE)), 1)
    room = height - _title_height(wrap(state)) - 2 * _ABOVE_SECTIONS
    kept: list[SectionText] = []
    for section in sections:
        room -= _HEADING
        if room < 0:
            if kept:
                kept[-1] = kept[-1]._replace(name=f"{kept[-1].name.removesuffix(_CUT)}{_CUT}")
            break
        lines = [
            line if len(line) <= letters else f"{line[: letters - 1]}…" for line in section.lines
        ]
        shown = tuple(lines[: int(room / line_height(style.CODE_SIZE))])
        room -= len(shown) * line_height(style.CODE_SIZE)
        kept.append(SectionText(section.name + _CUT * (len(shown) < len(lines)), shown))
    return tuple(kept)


def box_lines(box: Box) -> Iterator[Text]:
    """Yield the text of a box: its title, in the middle or above the sections."""
    y = box.top + _ABOVE_SECTIONS if box.sections else box.y - _title_height(box.title) / 2
    for line in box.title:
        y += line_height(style.TITLE_SIZE)
        base = y - line_height(style.TITLE_SIZE) / 2 + _BASELINE * style.TITLE_SIZE
        yield Text(box.x, base, line, style.TITLE_SIZE, style.INK, "bold", True)
    x = box.left + _PADDING
    for section in box.sections:
        y += _HEADING
        base = y - _BASELINE * style.HEADING_SIZE
        yield Text(x, base, section.name, style.HEADING_SIZE, style.ACCENT, "bold", False)
        for line in section.lines:
            y += line_height(style.CODE_SIZE)
            base = y - _BASELINE * style.CODE_SIZE
            yield Text(x, base, line, style.CODE_SIZE, style.CODE, "code", False)


def label_lines(label: Label) -> Iterator[Text]:
    """Yield the text of a label."""
    size = style.LABEL_SIZE
    y = label.y - (len(label.lines) - 1) / 2 * line_height(size) + _BASELINE * size
    for line in label.lines:
        yield Text(label.x, y, line, size, style.LABEL, "regular", True)
        y += line_height(size)


def _title_height(title: tuple[str, ...]) -> float:
    return len(title) * line_height(style.TITLE_SIZE)
