"""Recordings of a whiteboard and its machines, as MCAP files that Foxglove and PlotJuggler open.

Read in this order: :mod:`.exact` (messages as JSON, without loss), :mod:`.writer`, :mod:`.index`
and :mod:`.reader` (the file), :mod:`.receiver` and :mod:`.recorder` (from a board into a file),
:mod:`.replay` (back onto a board), :mod:`.rerun` (the machines once more, compared with what they
did), :mod:`.playback` (on a page).
"""

from importlib.util import find_spec

from .errors import McapMissingError

if find_spec("mcap") is None:
    raise McapMissingError("recordings need mcap; install it with: pip install 'llfsm[record]'")
