"""Transforms are tf2's, to the last words of its errors."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from llfsm.bridges.ros2.errors import (
    ConnectivityError,
    ExtrapolationError,
    FrameLookupError,
    FrameNameError,
    TransformError,
)
from llfsm.bridges.ros2.transforms import TransformBuffer
from llfsm.whiteboard.messages.builtin_interfaces import Time
from llfsm.whiteboard.messages.geometry_msgs import (
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)
from llfsm.whiteboard.messages.std_msgs import Header

_RECORDED = Path(__file__).parents[3] / "data" / "ros2" / "tf2.jsonl"
_KINDS = {
    "connectivity": ConnectivityError,
    "extrapolation": ExtrapolationError,
    "invalid": FrameNameError,
    "lookup": FrameLookupError,
}


def stamped(line) -> TransformStamped:
    return TransformStamped(
        Header(Time(*line["stamp"]), line["parent"]),
        line["child"],
        Transform(Vector3(*line["translation"]), Quaternion(*line["rotation"])),
    )


def answer(buffer: TransformBuffer, line):
    """Return what tf2 answers to a line, as it was recorded."""
    try:
        found = buffer.lookup(line["target"], line["source"], Time(*line["stamp"]))
    except TransformError as error:
        kind = next(kind for kind, cls in _KINDS.items() if type(error) is cls)
        return {"error": kind, "text": str(error)}
    assert (found.header.frame_id, found.child_frame_id) == (line["target"], line["source"])
    offset, turn = found.transform.translation, found.transform.rotation
    return {
        "stamp": [found.header.stamp.sec, found.header.stamp.nanosec],
        "translation": pytest.approx([offset.x, offset.y, offset.z], abs=1e-12),
        "rotation": pytest.approx([turn.x, turn.y, turn.z, turn.w], abs=1e-12),
    }


def test_answers_and_errors_are_those_recorded_from_tf2():
    buffer, asked = TransformBuffer(), 0
    with _RECORDED.open() as lines:
        for number, line in enumerate(map(json.loads, lines), 1):
            if line["op"] == "reset":
                buffer = TransformBuffer(line["keep_s"])
                continue
            expected = line["answer"]
            if line["op"] == "set":
                assert buffer.add(stamped(line), static=line["static"]) is expected["taken"], number
                continue
            asked += 1
            got = answer(buffer, line)
            if "loop" in expected.get("text", ""):  # tf2 goes on with a list of all frames
                expected["text"] = expected["text"].partition("\n")[0]
            assert expected == got, number
    assert asked == 286


def test_why_a_transform_is_ignored_is_logged_once_for_each_frame(caplog):
    buffer = TransformBuffer()
    own = TransformStamped(Header(frame_id="/map"), "map")
    assert not buffer.add(own)
    assert not buffer.add(own)
    assert not buffer.add(TransformStamped(Header(frame_id="base"), "base"))
    logged = [record.getMessage() for record in caplog.records]
    assert len(logged) == 2
    assert logged[0].startswith("a transform of frame 'map' is ignored: TF_SELF_TRANSFORM")
