"""The errors of recordings.

::

    LlfsmError
    ├── RecordingError             a recording cannot be made or used as requested
    │   ├── RecordingFileError         the file cannot be read or written, or is not a recording
    │   └── McapMissingError           the library is not installed (also an ImportError)
    └── RerunError                 machines act differently from the recording (also an
                                   AssertionError)
"""

from __future__ import annotations

from llfsm.errors import LlfsmError


class RecordingError(LlfsmError):
    """A recording cannot be made or used as requested: the message says why not."""


class RecordingFileError(RecordingError):
    """A file cannot be read or written, or is not a recording."""


class McapMissingError(RecordingError, ImportError):
    """The library for MCAP files is not installed."""


class RerunError(LlfsmError, AssertionError):
    """Machines act differently from the recording; the message shows the first difference."""
