"""Recordings of a whiteboard and its machines, as MCAP files that Foxglove and PlotJuggler open.

Read in this order: :mod:`.writer` and :mod:`.recorders` (from a board into a file),
:mod:`.mcap_file`, :mod:`.bags` and :mod:`.reader` (the file), :mod:`.replay` (its messages onto a
board), :mod:`.rerun` (the machines once more, compared with what they did), :mod:`.reversing`
(backwards through a rerun), :mod:`.page` (on a page).
"""

from importlib.util import find_spec

from llfsm.bridges.recording.errors import McapMissingError

if find_spec("mcap") is None:
    raise McapMissingError("recordings need mcap; install it with: pip install 'llfsm[record]'")
