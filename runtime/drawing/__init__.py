"""Draw machines: as text for Graphviz and Mermaid, and as pictures with a layout of our own.

`arrange` makes a `Diagram`, plain geometry, of a machine's table; `to_svg` and `to_png` write it.
"""

from .arrange import arrange
from .diagram import Box, Diagram, Edge, Label, Point
from .dot import to_dot
from .mermaid import to_mermaid
from .png import to_png
from .svg import to_svg

__all__ = [
    "Box",
    "Diagram",
    "Edge",
    "Label",
    "Point",
    "arrange",
    "to_dot",
    "to_mermaid",
    "to_png",
    "to_svg",
]
