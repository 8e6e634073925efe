"""The errors of a gusimplewhiteboard.

::

    LlfsmError
    └── GuWhiteboardError
        ├── GuFileError          the file does not exist, cannot be opened, or was removed
        │   └── GuFormatError    it is not a gusimplewhiteboard of the supported version
        ├── LayoutError          a layout is invalid, too large, or does not match the message type
        └── MisfitError          a message's values do not fit the layout, or vice versa

A misfit ends nothing: the message is not relayed, and the relay logs one warning.
"""

from llfsm.errors import LlfsmError


class GuWhiteboardError(LlfsmError):
    """The base of the errors of the bridge to a gusimplewhiteboard."""


class GuFileError(GuWhiteboardError):
    """The file does not exist, cannot be opened, or was removed or replaced."""


class GuFormatError(GuFileError):
    """The file is not a gusimplewhiteboard of version 2207; the message names the difference."""


class LayoutError(GuWhiteboardError):
    """A layout is invalid, takes too many bytes, or does not match the messages' type."""


class MisfitError(GuWhiteboardError):
    """A message does not fit its layout, or the bytes are not a valid message."""
