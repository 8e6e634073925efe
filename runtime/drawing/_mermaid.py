"""A machine as text in Mermaid's language of state diagrams."""

from __future__ import annotations

import json

from llfsm.runtime.drawing.typeset import numbered_labels, printable, section_texts
from llfsm.runtime.engine.table import Table


def to_mermaid(table: Table, *, title: str | None = None, sections: bool = False) -> str:
    """Write a machine's table as a Mermaid stateDiagram-v2; sections become notes.

    Accepting states lead to the end mark, and the suspend state has a dashed border.
    """
    ids = {state: f"s{i}" for i, state in enumerate(table.states)}
    title = printable(table.path if title is None else title)
    lines = ["---", f"title: {json.dumps(title, ensure_ascii=False)}", "---", "stateDiagram-v2"]
    lines += [f'    state "{_text(state.name)}" as {name}' for state, name in ids.items()]
    lines.append(f"    [*] --> {ids[table.initial]}")
    for state, name in ids.items():
        for transition, label in zip(state.transitions, numbered_labels(state), strict=True):
            written = f" : {_text(label)}" if label else ""
            lines.append(f"    {name} --> {ids[transition.target]}{written}")
        if state.accepting:
            lines.append(f"    {name} --> [*]")
        note = [
            _text(line)
            for section in section_texts(state, sections=sections)
            for line in (section.name, *(f"    {line}" for line in section.lines))
        ]
        if note:
            lines.append(f"    note right of {name} : {'<br/>'.join(note)}")
    if table.suspend is not None:
        lines += [
            "    classDef suspend stroke-dasharray: 6 4",
            f"    class {ids[table.suspend]} suspend",
        ]
    return "\n".join([*lines, ""])


def _text(text: str) -> str:
    """Escape text: all but letters, digits and single spaces becomes a numbered entity."""
    text = printable(text)
    written = []
    for i, character in enumerate(text):
        if character == "\n":
            written.append("<br/>")
        elif (
            character.isalnum()
            or character in "_.,()="
            or (character == " " and text[i - 1 : i].strip())
        ):
            written.append(character)
        else:
            written.append(f"#{160 if character == ' ' else ord(character)};")
    return "".join(written)
