"""What is fed: each target makes a case from random numbers and checks what must hold for it.

A target raises whatever is not an error of llfsm's own.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import msgspec
from mutation import damaged, damaged_text
from page_socket import PageServer

from hostile_peer import Hostile
from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.writer import RecordingWriter
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.view.page_requests import FrameShown, decode, perform
from llfsm.errors import LlfsmError
from llfsm.runtime.bundles.read import read_bundle
from llfsm.runtime.plans import read_dispatch_table, read_plan, read_toml
from llfsm.whiteboard import Message, Slot, Whiteboard
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.geometry_msgs import Vector3
from llfsm.whiteboard.messages.std_msgs import Int64, String
from llfsm.whiteboard.mirror.batches import Batch, Declaration, Value, Version
from llfsm.whiteboard.mirror.exchange import Exchange
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.store import Store, VersionLog

__all__ = ["TARGETS"]

ROOT = Path(__file__).parents[2]

# ---- Segments -------------------------------------------------------------------------------

_MESSAGES: dict[Slot[Any], Message] = {
    Slot("number", Int64): Int64(-5),
    Slot("place", Vector3): Vector3(1.0, 2.0, 3.0),
    Slot("text", String): String("first"),
    Slot("new", String): String("new"),
}
_SLOTS, _HEADER = 448, 448 + 8 * 4096  # offsets, by llfsm_whiteboard.h


@cache
def _segment(folder: Path) -> bytes:
    with Whiteboard("sound", directory=folder) as board:
        for slot, message in list(_MESSAGES.items())[:3]:
            board.add_message(slot, message)
        return board.path.read_bytes()


def segments(choose: Random, folder: Path) -> None:
    """A damaged board gives errors of ours, and what it yields is a message."""
    sound = _segment(folder)
    places = [*range(0, _SLOTS, 4), *range(_SLOTS, _SLOTS + 64, 8), *range(_HEADER, len(sound), 8)]
    path = folder / "llfsm.bad"
    path.write_bytes(damaged(choose, sound, places))
    with suppress(LlfsmError), Whiteboard("bad", directory=folder) as board:
        with suppress(LlfsmError):
            board.slots()
        for slot, message in _MESSAGES.items():
            with suppress(LlfsmError):
                bound = board[slot]
                for use in (
                    bound.get,
                    bound.sample,
                    lambda b=bound, m=message: b.add(m),
                    bound.get,
                ):
                    with suppress(LlfsmError):
                        assert not isinstance(found := use(), Message) or isinstance(
                            found, slot.type
                        )


# ---- CDR ------------------------------------------------------------------------------------

_TYPES = ("geometry_msgs/msg/Twist", "std_msgs/msg/String", "sensor_msgs/msg/LaserScan",
          "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "diagnostic_msgs/msg/DiagnosticArray",
          "sensor_msgs/msg/PointCloud2")  # fmt: skip


@cache
def _ros_type(name: str) -> Any:
    return TypeLibrary().message(name)


def cdr(choose: Random, folder: Path) -> None:
    """What can be decoded can be encoded again, to what decodes to the same bytes."""
    ros = _ros_type(choose.choice(_TYPES))
    sound = ros.encode(ros.message()) + choose.randbytes(choose.choice((0, 0, 4, 40, 400)))
    data = damaged(choose, sound, range(0, len(sound), 4))
    with suppress(LlfsmError):
        again = ros.encode(ros.decode(data))
        assert ros.encode(ros.decode(again)) == again


# ---- The mirror -----------------------------------------------------------------------------


def mirror(choose: Random, folder: Path) -> None:
    """Whatever a host has sent, what a host may not touch stays, and others' messages enter."""
    now_ns = 10**18
    board = LocalBoard("board", now_ns=lambda: now_ns)
    settings = Settings(access={"hostile": ("hostile/*",), "robot": ("robot/*",)})
    store = Store(board, 1, lambda stamp: stamp, VersionLog(),
                  lambda: now_ns + settings.ahead_ns)  # fmt: skip
    exchange = Exchange(store, settings, lambda: now_ns, lambda: now_ns)
    mine, theirs = Slot("mine", Int64), Slot("robot/number", Int64)
    board.add_message(mine, Int64(1))
    hostile = Hostile(choose.getrandbits(32), choose.choice(("hostile/", "robot/", "")))
    for _ in range(3):
        exchange.receive_batch(hostile.batch(), "hostile")
        exchange.receive_reply(hostile.batch(), "hostile")
        exchange.receive_heartbeat(hostile.heartbeat(), "hostile")
        exchange.reply(hostile.query(), "hostile")
        exchange.queries()
        exchange.collect([slot.name for slot in board.slots()])
        exchange.enter_held()
        now_ns += choose.choice((0, 10**6, 10**9))
    value = Value(theirs.name, theirs.fingerprint, Version(now_ns, 2), b"\x91\x07")
    declaration = Declaration(theirs.name, 64, theirs.schema)
    batch = Batch(2, 1, 1, now_ns, (value,), (declaration,))
    exchange.receive_batch(msgspec.msgpack.encode(batch), "robot")
    assert board.get_message(theirs) == Int64(7)
    assert board.get_message(mine) == Int64(1)
    assert all(slot.name.startswith(("mine", "robot/number", "hostile/", "llfsm/"))
               for slot in board.slots())  # fmt: skip
    exchange.status()


# ---- Recordings -----------------------------------------------------------------------------


@cache
def _recording(folder: Path) -> bytes:
    path = folder / "sound.mcap"
    with LocalBoard("board") as board, RecordingWriter(path, {"board": "board"}) as writer:
        for number in range(50):
            for slot, message in _MESSAGES.items():
                board.add_message(slot, message)
                writer.add(slot, board[slot].sample(), new=number == 0)
    return path.read_bytes()


def _records(data: bytes) -> list[int]:
    """Return where the records of an MCAP file begin, and their lengths are."""
    at, found = 8, []
    while at + 9 <= len(data) - 8:
        found += [at, at + 1, at + 9]
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    return found


def recordings(choose: Random, folder: Path) -> None:
    """A damaged recording is read up to an error of ours."""
    sound = _recording(folder)
    path = folder / "bad.mcap"
    path.write_bytes(damaged(choose, sound, _records(sound)))
    with suppress(LlfsmError):
        recording = Recording(path)
        assert len(recording.span_ns) == 2
        for slot, message in recording.messages():
            slot.sample(message)


# ---- Requests of pages ----------------------------------------------------------------------

_REQUESTS: tuple[dict[str, Any], ...] = (
    {"type": "ask", "id": 1, "machine": "Patrol", "action": "suspend"},
    {"type": "post", "id": 2, "slot": "place", "message": {"x": 1.0, "y": -2.5, "z": 0}},
    {"type": "post", "id": 3, "slot": "text", "message": {"data": "words"}},
    {"type": "seek", "id": 4, "at": 1.5},
    {"type": "play", "id": 5, "speed": 2},
    {"type": "seen"},
)


class _Source:
    """A board, and no recording."""

    player = None

    def __init__(self, board: Whiteboard) -> None:
        self._board = board

    def board(self) -> Whiteboard:
        return self._board


@cache
def _server() -> PageServer:
    return PageServer(_MESSAGES)


def websocket(choose: Random, folder: Path) -> None:
    """Whatever a client sends, the server goes on, and serves another page at once."""
    _server().attack(choose, _REQUESTS)


def requests(choose: Random, folder: Path) -> None:
    """A request of a page is carried out or refused."""
    text = damaged_text(choose, json.dumps(choose.choice(_REQUESTS)))
    with Whiteboard("page", directory=folder) as board:
        for slot, message in _MESSAGES.items():
            board.add_message(slot, message)
        with suppress(LlfsmError):
            request = decode(text)
            if not isinstance(request, FrameShown):
                perform(request, _Source(board), control=True)  # type: ignore[arg-type]


# ---- Files of machines and settings ---------------------------------------------------------


def bundles(choose: Random, folder: Path) -> None:
    """A damaged bundle is read or refused."""
    sources = [*ROOT.glob("machines/*.machine"), *ROOT.glob("tests/data/bundles/*.machine")]
    bundle = folder / "Bad.machine"
    shutil.rmtree(bundle, ignore_errors=True)
    shutil.copytree(choose.choice(sorted(sources)), bundle)
    files = sorted(path for path in bundle.rglob("*") if path.is_file())
    for _ in range(choose.randrange(1, 4)):
        path = choose.choice(files)
        match choose.randrange(4):
            case 0:
                path.unlink(missing_ok=True)
            case 1:
                path.write_bytes(damaged(choose, path.read_bytes() if path.exists() else b""))
            case _:
                text = path.read_text(errors="replace") if path.exists() else ""
                path.write_text(damaged_text(choose, text))
    with suppress(LlfsmError):
        read_bundle(bundle)


_PLAN = """
schedule = "fixed"
period_ms = 10
[[machine]]
name = "patrol"
machine = "llfsm.machines.ping_pong:RosPingPong"
period_ms = 20.5
"""
_SETTINGS = """
listen = ["tcp/0.0.0.0:7447"]
enter = ["operator/*"]
rate = 50
[rates]
"robot/*" = 5.5
[access]
laptop = ["operator/*"]
[quota]
slots = 10
"""
_TABLE = """3,10,0,llfsm.machines.ping_pong:RosPingPong
2,20,5,other

0,10
1,5
"""


def configuration(choose: Random, folder: Path) -> None:
    """An arrangement, settings and a dispatch table are read, or refused with file and line."""
    readers: tuple[tuple[str, Callable[[Path], object]], ...] = (
        (_PLAN, read_plan),
        (_SETTINGS, lambda path: read_toml(path, Settings)),
        (_TABLE, read_dispatch_table),
    )
    text, read = choose.choice(readers)
    path = folder / "bad.toml"
    path.write_text(damaged_text(choose, text))
    with suppress(LlfsmError):
        read(path)


TARGETS: dict[str, Callable[[Random, Path], None]] = {
    target.__name__: target
    for target in (
        segments,
        cdr,
        mirror,
        recordings,
        websocket,
        requests,
        bundles,
        configuration,
    )
}
