"""Post to the slot that the machines of `commanding.py` command, without a machine.

`posting.py BOARD` guards the board as bridges do, reads numbers from its standard input, adds so
many messages, and prints a line after that; `posting.py BOARD SECONDS` goes on, with that pause
between two.
"""

from __future__ import annotations

import logging
import sys
import time

from commanding import CMD
from llfsm.runtime.presence.guard import GuardThread
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32

if __name__ == "__main__":
    logging.basicConfig(format="%(message)s")
    with Whiteboard(sys.argv[1]) as board, GuardThread(board.name):
        while sys.argv[2:]:
            board.add_message(CMD, Int32())
            time.sleep(float(sys.argv[2]))
        for line in sys.stdin:
            for _ in range(int(line)):
                board.add_message(CMD, Int32())
            print("added", flush=True)
