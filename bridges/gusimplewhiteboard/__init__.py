"""A gusimplewhiteboard, the shared memory of clfsm's machines, beside a whiteboard.

Read :mod:`.file` (where its bytes are), :mod:`.structures` (what they mean), :mod:`.relay` (what is
relayed and when, and its configuration).
"""

from llfsm.bridges.gusimplewhiteboard._structures import find_layout
from llfsm.bridges.gusimplewhiteboard.errors import (
    GuFileError,
    GuFormatError,
    GuWhiteboardError,
    LayoutError,
    MisfitError,
)
from llfsm.bridges.gusimplewhiteboard.file import GuWhiteboard
from llfsm.bridges.gusimplewhiteboard.relay import Relay

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
