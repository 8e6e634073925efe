"""A gusimplewhiteboard, the shared memory of clfsm's machines, beside a whiteboard.

Read :mod:`.file` (where its bytes are), :mod:`.message_layouts` and :mod:`.structures` (what they
mean), :mod:`.relay` (what is relayed and when), :mod:`.relay_configuration`.
"""

from .errors import GuFileError, GuFormatError, GuWhiteboardError, LayoutError, MisfitError
from .file import GuWhiteboard
from .message_layouts import find_layout
from .relay import Relay

__all__ = [
    "GuFileError",
    "GuFormatError",
    "GuWhiteboard",
    "GuWhiteboardError",
    "LayoutError",
    "MisfitError",
    "Relay",
    "find_layout",
]
