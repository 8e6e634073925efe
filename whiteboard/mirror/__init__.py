"""One whiteboard on several hosts: each has its own in memory, and Zenoh carries what changes.

Read in this order: :mod:`.merge` (which message is the newer one), :mod:`.wire` (what travels),
:mod:`.store` (a board with versions), :mod:`.exchange` (one host's part, without network or
clock), then :mod:`.network` (Zenoh), :mod:`.mirror` (both together, in a loop) and its users,
:mod:`.daemon` and :mod:`.client`.
"""
