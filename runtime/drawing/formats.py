"""The formats in which machines are drawn: one table, from which `llfsm draw` has its choices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from llfsm.runtime.drawing._dot import to_dot
from llfsm.runtime.drawing._mermaid import to_mermaid
from llfsm.runtime.drawing.arrange import Find, arrange
from llfsm.runtime.drawing.diagram import Diagram, to_png, to_svg
from llfsm.runtime.engine.table import Table


class Format(NamedTuple):
    """A format of files with these suffixes, written from a diagram or from a machine's table.

    A format of text has no places, so that an overview, which is a diagram, cannot be written in
    it. A writer returns text, or bytes for a format that is none.
    """

    suffixes: tuple[str, ...]
    write_diagram: Callable[[Diagram], str | bytes] | None = None
    write_table: Callable[..., str] | None = None
    """Takes a table and, by name, `title` and `sections`, which is True or False."""

    def draw(
        self, table: Table, title: str, sections: bool | None, unfold: Find | None = None
    ) -> str | bytes:
        """Draw a machine; `sections` and `unfold` are as for `arrange`.

        Text has no machines in others, and None hides its sections.
        """
        if self.write_diagram is not None:
            diagram = arrange(table, title=title, sections=sections, unfold=unfold)
            return self.write_diagram(diagram)
        assert self.write_table is not None
        return self.write_table(table, title=title, sections=bool(sections))


FORMATS: Final = {
    "dot": Format((".dot", ".gv"), write_table=to_dot),
    "mermaid": Format((".mmd", ".mermaid"), write_table=to_mermaid),
    "svg": Format((".svg",), write_diagram=to_svg),
    "png": Format((".png",), write_diagram=to_png),
}
"""By name, the default of `llfsm draw` first."""
