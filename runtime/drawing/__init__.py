"""Draw machines: as text for Graphviz and Mermaid, and as pictures with a layout of our own.

`arrange` makes a `Diagram`, plain geometry, of a machine's table; `to_svg` and `to_png` write it.
`overview` draws the machines of an arrangement and their slots; `timeline` shows what machines did.

From the bottom up: `curves` and `shapes` (what pictures consist of), `svg` and `png` (their
writers), `style` and `typeset` (looks and words), `diagram`, the two layouts, `arrange`, and
`formats`, the table of all formats.
"""

from llfsm.runtime.drawing._dot import to_dot
from llfsm.runtime.drawing._mermaid import to_mermaid
from llfsm.runtime.drawing._timeline import Stay, Timeline, timeline
from llfsm.runtime.drawing.arrange import MachineLinks, arrange, overview
from llfsm.runtime.drawing.curves import Point
from llfsm.runtime.drawing.diagram import Box, Diagram, Edge, Label, to_png, to_svg

__all__ = [
    "Box",
    "Diagram",
    "Edge",
    "Label",
    "MachineLinks",
    "Point",
    "Stay",
    "Timeline",
    "arrange",
    "overview",
    "timeline",
    "to_dot",
    "to_mermaid",
    "to_png",
    "to_svg",
]
