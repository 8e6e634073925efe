"""A machine as text in Graphviz's DOT language."""

from __future__ import annotations

from html import escape

from llfsm.runtime.drawing.typeset import numbered_labels, printable, section_texts
from llfsm.runtime.engine.state import State
from llfsm.runtime.engine.table import Table


def to_dot(table: Table, *, title: str | None = None, sections: bool = False) -> str:
    """Write a machine's table as DOT: accepting states have two borders, suspend states dashes."""
    ids = {state: f"s{i}" for i, state in enumerate(table.states)}
    lines = [
        f'digraph "{_text(table.path if title is None else title)}" {{',
        '    node [shape=box, style=rounded, fontname="Helvetica"]',
        '    edge [fontname="Helvetica", fontsize=11]',
        '    start [shape=point, width=0.15, label=""]',
    ]
    for state, name in ids.items():
        marks = [f'label="{_content(state, sections)}"']
        if state.accepting:
            marks.append("peripheries=2")
        if state is table.suspend:
            marks.append('style="rounded,dashed"')
        lines.append(f"    {name} [{', '.join(marks)}]")
    lines.append(f"    start -> {ids[table.initial]}")
    for state, name in ids.items():
        for transition, label in zip(state.transitions, numbered_labels(state), strict=True):
            lines.append(f'    {name} -> {ids[transition.target]} [label="{_text(label)}"]')
    return "\n".join([*lines, "}", ""])


def _content(state: State, sections: bool) -> str:
    content = _text(state.name)
    for section in section_texts(state, sections=sections):
        content += rf"\n\n{section.name}\l"
        content += "".join(f"    {_text(line)}\\l" for line in section.lines)
    return content


def _text(text: str) -> str:
    """Escape text for a quoted string: Graphviz reads entities and backslashes in it."""
    text = escape(printable(text), quote=False)
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
