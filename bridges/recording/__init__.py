"""Recordings of a whiteboard and its machines, as MCAP files that Foxglove and PlotJuggler open.

Read in this order: :mod:`.json_codec` (messages as JSON, without loss), :mod:`.writer`,
:mod:`.mcap_file`, :mod:`.index` and :mod:`.reader` (the file), :mod:`.journal_recorder` and
:mod:`.board_recorder` (from a board into a file), :mod:`.board_replay` (back onto a board),
:mod:`.rerun` (the machines once more, compared with what they did), :mod:`.recorded_history` and
:mod:`.recorded_source` (on a page).
"""

from importlib.util import find_spec

from llfsm.bridges.recording.errors import McapMissingError

if find_spec("mcap") is None:
    raise McapMissingError("recordings need mcap; install it with: pip install 'llfsm[record]'")
