"""One whiteboard on several hosts: each has a board in memory, and Zenoh carries the changes.

Read in this order: :mod:`.batches` (what hosts send, and which message is newer), :mod:`.store` (a
board with versions), :mod:`.arrivals` (what may enter it), :mod:`.exchange` (one host's part,
without network or clock), then :mod:`.network` (Zenoh), :mod:`.mirror` (both in a loop) and its
users, :mod:`.daemon` and :mod:`.remote_board`.
"""
