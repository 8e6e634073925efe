"""The errors of recordings.

::

    LlfsmError
    ├── RecordingError             a recording cannot be made or used as requested
    │   ├── RecordingFileError         the file cannot be read or written, or is not a recording
    │   ├── McapMissingError           the library is not installed (also an ImportError)
    │   ├── NoEventsError              it has no events from the machines' start: nothing to rerun
    │   ├── OtherMachinesError         the machines given are not those recorded, or read
    │   │                              what a bag does not have
    │   ├── MomentError                there is no such moment to go to, or nothing to look at
    │   └── MachinesGoneError          the process in which machines run again has ended
    └── RerunError                 machines act differently from the recording (also an
                                   AssertionError)
"""

from __future__ import annotations

from llfsm.errors import LlfsmError


class RecordingError(LlfsmError):
    """A recording cannot be made or used as requested."""


class RecordingFileError(RecordingError):
    """A file cannot be read or written, or is not a recording."""


class McapMissingError(RecordingError, ImportError):
    """The library for MCAP files is not installed."""


class NoEventsError(RecordingError):
    """A recording has no events from the machines' start."""


class OtherMachinesError(RecordingError):
    """The machines given are not those that were recorded, or read what a bag does not have."""


class MomentError(RecordingError):
    """There is no such moment in a recording, or nothing to look at there."""


class MachinesGoneError(RecordingError):
    """The process in which machines run again has ended."""


class RerunError(LlfsmError, AssertionError):
    """Machines act differently from the recording; the message shows the first difference."""
