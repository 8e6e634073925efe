"""Messages of the Debug Adapter Protocol: a header with their length, and JSON.

https://microsoft.github.io/debug-adapter-protocol/overview#base-protocol
"""

from __future__ import annotations

import json
import threading
from contextlib import suppress
from typing import IO, Any, Final, TypeAlias

from llfsm.errors import LlfsmError

Message: TypeAlias = dict[str, Any]

_LONGEST: Final = 1 << 24  # bytes of a message: a longer one is nonsense


class MessageStream:
    """Read messages from one stream, and write to another; any thread may write."""

    def __init__(self, received: IO[bytes], sent: IO[bytes]):
        self._received = received
        self._sent = sent
        self._lock = threading.Lock()
        self._number = 0

    def receive(self) -> Message | None:
        """Wait for a message; None at the end of the stream. Raise `LlfsmError` for other data."""
        length = None
        while True:
            line = self._received.readline(1 << 12)
            if not line:
                return None
            if not line.strip():
                break
            name, _, value = line.partition(b":")
            if name.strip().lower() == b"content-length" and value.strip().isdigit():
                length = int(value)
        if length is None or length > _LONGEST:
            raise LlfsmError("a message came without a valid Content-Length")
        body = self._received.read(length)
        if len(body) < length:
            return None
        try:
            message = json.loads(body)
        except (ValueError, RecursionError) as error:
            raise LlfsmError(f"a message came that is not JSON: {error}") from error
        if not isinstance(message, dict):
            raise LlfsmError(f"a message came that is not an object: {message!r}")
        return message

    def send(self, kind: str, **fields: Any) -> None:
        """Send a message, unless the editor is gone: code that prints must not fail by it."""
        with self._lock, suppress(BrokenPipeError):
            self._number += 1
            body = json.dumps({"seq": self._number, "type": kind, **fields}).encode()
            self._sent.write(b"Content-Length: %d\r\n\r\n%s" % (len(body), body))
            self._sent.flush()
