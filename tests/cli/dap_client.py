"""A client of the Debug Adapter Protocol, as editors are: it checks each message that comes."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any

from llfsm.cli.dap.adapter import Adapter
from llfsm.cli.dap.framing import MessageStream

__all__ = ["Client", "client"]

BODIES: dict[str, dict[str, type]] = {  # of the specification: what is required
    "stopped": {"reason": str, "threadId": int},
    "continued": {"threadId": int},
    "output": {"output": str},
    "exited": {"exitCode": int},
    "terminated": {},
    "initialized": {},
    "initialize": {},
    "setBreakpoints": {"breakpoints": list},
    "setFunctionBreakpoints": {"breakpoints": list},
    "threads": {"threads": list},
    "stackTrace": {"stackFrames": list},
    "scopes": {"scopes": list},
    "variables": {"variables": list},
    "evaluate": {"result": str, "variablesReference": int},
}
ITEMS: dict[str, dict[str, type]] = {
    "breakpoints": {"verified": bool},
    "threads": {"id": int, "name": str},
    "stackFrames": {"id": int, "name": str, "line": int, "column": int},
    "scopes": {"name": str, "variablesReference": int, "expensive": bool},
    "variables": {"name": str, "value": str, "variablesReference": int},
}


class Client:
    """What an editor does: send requests, and check each message that comes."""

    def __init__(self, received: IO[bytes], sent: IO[bytes]):
        self._received, self._sent = received, sent
        self._asked = self._received_count = 0
        self.events: list[dict[str, Any]] = []
        self.seen: list[dict[str, Any]] = []  # all events that came

    def ask(self, command: str, **arguments: Any) -> dict[str, Any]:
        """Send a request and return the body of its response."""
        response = self.response(command, arguments)
        assert response["success"], response
        return response.get("body", {})

    def refused(self, command: str, **arguments: Any) -> str:
        response = self.response(command, arguments)
        assert not response["success"]
        assert response["body"]["error"]["format"] == response["message"]
        return response["message"]

    def response(self, command: str, arguments: dict[str, Any]) -> dict[str, Any]:
        self._asked += 1
        request = {"seq": self._asked, "type": "request", "command": command}
        body = json.dumps({**request, "arguments": arguments}).encode()
        self._sent.write(b"Content-Length: %d\r\n\r\n" % len(body) + body)
        self._sent.flush()
        while (message := self.receive())["type"] != "response":
            self.events.append(message)
        assert (message["request_seq"], message["command"]) == (self._asked, command)
        return message

    def event(self, name: str) -> dict[str, Any]:
        """Return the body of the next event of that name."""
        while True:
            message = self.events.pop(0) if self.events else self.receive()
            if message["event"] == name:
                return message["body"]

    def receive(self) -> dict[str, Any]:
        header = self._received.readline()
        assert header.startswith(b"Content-Length: "), header
        assert self._received.readline() == b"\r\n"
        message: dict[str, Any] = json.loads(self._received.read(int(header[16:])))
        self._received_count += 1
        assert message["seq"] == self._received_count
        if message["type"] == "event":
            self.seen.append(message)
        if message["type"] == "event" or message.get("success"):
            required = BODIES.get(message.get("event", message.get("command")), {})
            has_shape(message["body"], required)
            for name, items in message["body"].items():
                for item in items if name in ITEMS else ():
                    has_shape(item, ITEMS[name])
        return message

    def begin(self, board: str, *machines: str, **arguments: Any) -> None:
        self.ask("initialize", adapterID="llfsm")
        self.ask("launch", **{"machines": [*machines], "board": board, **arguments})
        self.event("initialized")


def has_shape(found: dict[str, Any], required: dict[str, type]) -> None:
    for name, kind in required.items():
        assert type(found[name]) is kind, (name, found)


@contextmanager
def client() -> Iterator[Client]:
    """Serve a client in a thread, as a process would."""
    there, here = os.pipe(), os.pipe()
    received, sent = os.fdopen(there[0], "rb"), os.fdopen(here[1], "wb")
    with os.fdopen(there[1], "wb") as asking, os.fdopen(here[0], "rb") as answers:
        thread = threading.Thread(target=Adapter(MessageStream(received, sent)).serve)
        thread.start()
        try:
            yield Client(answers, asking)
        finally:
            asking.close()
            thread.join()
            received.close()
            sent.close()
