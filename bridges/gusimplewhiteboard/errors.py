"""What can go wrong with a gusimplewhiteboard.

    GuWhiteboardError
    ├── GuFileError          the file is not there, cannot be opened, or was removed meanwhile
    │   └── GuFormatError    it is no gusimplewhiteboard of the version that we know
    ├── LayoutError          a layout is none, too large, or does not match the messages' type
    └── MisfitError          a message's values do not fit the layout, or the other way round

A misfit ends nothing: the message is not relayed, and the relay says so once.
"""

from llfsm.errors import LlfsmError

__all__ = ["GuFileError", "GuFormatError", "GuWhiteboardError", "LayoutError", "MisfitError"]


class GuWhiteboardError(LlfsmError):
    """Everything that the bridge to a gusimplewhiteboard raises."""


class GuFileError(GuWhiteboardError):
    """The file is not there, cannot be opened, or was removed or replaced meanwhile."""


class GuFormatError(GuFileError):
    """The file is no gusimplewhiteboard of version 2207; the message says what is different."""


class LayoutError(GuWhiteboardError):
    """A layout is none, takes too many bytes, or does not match the messages' type."""


class MisfitError(GuWhiteboardError):
    """A message cannot be laid out, or what is laid out is no message."""
