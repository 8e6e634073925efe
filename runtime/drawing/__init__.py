"""Draw machines: as text for Graphviz and Mermaid, and as pictures with a layout of our own.

`arrange` makes a `Diagram`, plain geometry, of a machine's table; `to_svg` and `to_png` write it.
`overview` draws the machines of an arrangement and their slots; `timeline` shows what machines did.
"""

from .arrange import arrange
from .diagram import Box, Diagram, Edge, Label
from .dot import to_dot
from .mermaid import to_mermaid
from .overview import MachineLinks, overview
from .rendering import to_png, to_svg
from .shapes import PicturePoint
from .timeline import Stay, Timeline, timeline

__all__ = [
    "Box",
    "Diagram",
    "Edge",
    "Label",
    "MachineLinks",
    "PicturePoint",
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
