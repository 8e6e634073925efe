"""Draw machines: as text for Graphviz and Mermaid, and as pictures with a layout of our own.

`arrange` makes a `Diagram`, plain geometry, of a machine's table; `to_svg` and `to_png` write it.
"""

from .arrange import arrange
from .diagram import Box, Diagram, Edge, Label
from .dot import to_dot
from .mermaid import to_mermaid
from .rendering import to_png, to_svg
from .shapes import Point

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
