"""What Zenoh says of connections that are refused: in its log alone, which is read here."""

from __future__ import annotations

import os
import re
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout

__all__ = ["Complaints", "complaints", "understand"]

_FILTER = "zenoh_link_tls=warn,zenoh_link_quic=warn,zenoh::net::runtime::orchestrator=debug"
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_COMES = re.compile(r"WARN .*zenoh_link_\w+::\w+: (.*?)\. Hint:")
_GOES = re.compile(
    r"Unable to connect to configured peer (\S+)! (?:Can not create .*? link bound to .*?: )?"
    r"(.*?)(?: at /|\. Retry)"
)
_OF_TLS = re.compile("certificate|alert", re.IGNORECASE)  # and not: nobody is there yet


class Complaints:
    """Who is told what was refused, and why."""

    def __init__(self) -> None:
        self.hear: Callable[[str, str], object] = lambda what, why: None

    def read(self, pipe: int) -> None:
        """Read the log until it ends."""
        with open(pipe, errors="replace") as lines:
            for line in lines:
                if (found := understand(line)) is not None:
                    self.hear(*found)
                elif os.environ.get("RUST_LOG"):
                    print(line, end="", file=sys.stderr)  # who asks for Zenoh's log gets it


@contextmanager
def complaints() -> Iterator[Complaints]:
    """Read Zenoh's log within the context, for who then sets what is to `hear` of it.

    Zenoh logs to standard output and nowhere else. So within the context that is a pipe, and what
    Python prints goes where it went before. Sessions have to be closed within it, too.
    """
    import zenoh

    sys.stdout.flush()
    out = os.dup(1)
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.close(writing)
    found = Complaints()
    thread = threading.Thread(target=found.read, args=(reading,), name="complaints", daemon=True)
    thread.start()
    zenoh.init_log_from_env_or(_FILTER)
    try:
        with open(out, "w", closefd=False) as before, redirect_stdout(before):
            yield found
    finally:
        os.dup2(out, 1)  # with which the pipe ends
        os.close(out)
        thread.join()


def understand(line: str) -> tuple[str, str] | None:
    """Return what a line of the log says was refused, and why; None if it speaks of other things.

    A connection that comes is refused for what is wrong with it; one that goes out fails as long as
    nobody is there, which is not told.
    """
    line = _COLOUR.sub("", line)
    if comes := _COMES.search(line):
        return "a connection", comes[1]
    goes = _GOES.search(line)
    if goes and _OF_TLS.search(goes[2]):
        return f"by {goes[1]}", goes[2]
    return None
