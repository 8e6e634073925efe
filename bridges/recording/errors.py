"""The errors of recordings.

::

    FsmError
    ├── RecordingError             a recording cannot be made or used as asked
    │   ├── RecordingFileError         the file cannot be read or written, or is no recording
    │   ├── McapMissingError           the library is not installed (also an ImportError)
    │   ├── NoEventsError              it holds no events from machines' start: nothing to rerun
    │   └── OtherMachinesError         the machines given are not those recorded
    └── (AssertionError)
        └── RerunError                 machines do something else than they did (no FsmError)
"""

from __future__ import annotations

from llfsm.errors import LlfsmError

__all__ = [
    "McapMissingError",
    "NoEventsError",
    "OtherMachinesError",
    "RecordingError",
    "RecordingFileError",
    "RerunError",
]


class RecordingError(LlfsmError):
    """Say why a recording cannot be made or used as asked."""


class RecordingFileError(RecordingError):
    """Say which file cannot be read or written, or is no recording, and why."""


class McapMissingError(RecordingError, ImportError):
    """Say that the library for MCAP files is not installed, and how to install it."""


class NoEventsError(RecordingError):
    """Say that a recording holds no events from machines' start, and how to make one that does."""


class OtherMachinesError(RecordingError):
    """Name the machines that were recorded, and those that were given instead."""


class RerunError(AssertionError):
    """Show the first thing that machines do differently from what was recorded of them."""
