"""What a page may ask for: a machine's suspension and the like, a message, a moment."""

from __future__ import annotations

from typing import Any

import msgspec

from llfsm.runtime.engine.errors import FsmError
from llfsm.runtime.engine.events import Status
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import WhiteboardError
from llfsm.whiteboard.messages.llfsm import Action
from llfsm.whiteboard.shared import Whiteboard
from llfsm.whiteboard.text import parse_message

from .errors import RequestError
from .source import Source

__all__ = ["Request", "decode", "perform"]


class Ask(msgspec.Struct, tag="ask"):
    """Ask something of a machine."""

    id: int
    machine: str
    action: Action


class Post(msgspec.Struct, tag="post"):
    """Add a message to a slot; fields left out are zero."""

    id: int
    slot: str
    message: msgspec.Raw


class Seek(msgspec.Struct, tag="seek"):
    """Go to a moment of a recording: seconds from its beginning."""

    id: int
    at: float


class Play(msgspec.Struct, tag="play"):
    """Let a recording's time pass so many times as fast."""

    id: int
    speed: float


class Seen(msgspec.Struct, tag="seen"):
    """The page has shown a frame: it may be sent another one."""


Request = Ask | Post | Seek | Play | Seen

_decoder: msgspec.json.Decoder[Any] = msgspec.json.Decoder(Request)


def decode(text: str) -> Request:
    """Return what a page asks for, or raise `RequestError`."""
    try:
        request: Request = _decoder.decode(text)
    except ValueError as error:  # also msgspec's, which is one
        raise RequestError(f"this request is not understood: {error}") from error
    return request


def perform(request: Ask | Post | Seek | Play, source: Source, *, control: bool) -> str:
    """Do it and return what was done, or raise `RequestError`."""
    if isinstance(request, Seek | Play):
        return _move(request, source)
    board = source.board()
    if not control:
        raise RequestError("this page only shows; start it with: llfsm view --control")
    if board is None:
        raise RequestError("there is no live whiteboard to control")
    try:
        if isinstance(request, Post):
            assert isinstance(board, Whiteboard)
            slot = board.find(request.slot)
            count = board.add_message(slot, parse_message(slot, bytes(request.message)))
            return f"message {count} of {request.slot}"
        if Directory(board).find(request.machine).request(request.action) is Status.ERROR:
            raise RequestError(f"{request.machine} is about to restart; try again after that")
    except (WhiteboardError, FsmError) as error:
        raise RequestError(str(error)) from error
    return f"{request.machine}: asked to {request.action}"


def _move(request: Seek | Play, source: Source) -> str:
    player = source.player
    if player is None:
        raise RequestError("a live whiteboard has no other time than now")
    if isinstance(request, Play):
        if not 0 <= request.speed <= 1000:
            raise RequestError(f"a speed of {request.speed} is not in 0 to 1000")
        player.play(request.speed)
        return f"speed {request.speed:g}"
    first_ns, last_ns = player.span_ns
    player.seek(min(max(first_ns + round(request.at * 1e9), first_ns), last_ns))
    return f"at {request.at:.3f} s"
