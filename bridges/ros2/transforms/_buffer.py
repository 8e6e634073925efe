"""All frames as a tree, and the transform between any two of them.

The semantics, the words of the errors and the arithmetic are those of tf2 (Jazzy): people search
for these words, and a robot must not move otherwise than with tf2. Rotations are quaternions (x, y,
z, w), computed as tf2 does.

Each frame keeps its transforms to its parent in the last seconds, sorted by time. A lookup goes up
from both frames until the ways meet, and multiplies what it passes, interpolated at one time: the
latest at which all of the way is known, if none is asked for. A frame may change its parent, so
the way is found anew for each lookup.
"""

from __future__ import annotations

import logging
import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from operator import attrgetter
from typing import NamedTuple, TypeAlias, TypeVar

from llfsm.bridges.ros2.errors import (
    ConnectivityError,
    ExtrapolationError,
    FrameLookupError,
    FrameNameError,
)
from llfsm.bridges.ros2.node_time import from_ns, to_ns
from llfsm.whiteboard import Board, Slot
from llfsm.whiteboard.messages.builtin_interfaces import Time
from llfsm.whiteboard.messages.geometry_msgs import Quaternion as RosQuaternion
from llfsm.whiteboard.messages.geometry_msgs import Transform, TransformStamped, Vector3
from llfsm.whiteboard.messages.std_msgs import Header

_LOG = logging.getLogger("llfsm.bridges.ros2")

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

NO_OFFSET: Vector = (0.0, 0.0, 0.0)
IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Multiply: the rotation by `b`, then by `a`."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by + ay * bw + az * bx - ax * bz,
        aw * bz + az * bw + ax * by - ay * bx,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def inverse(q: Quaternion) -> Quaternion:
    """Invert the rotation of a unit quaternion."""
    x, y, z, w = q
    return -x, -y, -z, w


def rotated(q: Quaternion, v: Vector) -> Vector:
    """Rotate a vector by a unit quaternion."""
    x, y, z, _ = product(product(q, (*v, 0.0)), inverse(q))
    return x, y, z


def total(a: Vector, b: Vector) -> Vector:
    """Add two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def slerp(a: Quaternion, b: Quaternion, ratio: float) -> Quaternion:
    """Interpolate: the rotation at `ratio`, from 0 to 1, of the shorter way from `a` to `b`."""
    dot = sum(one * other for one, other in zip(a, b, strict=True))
    size = math.hypot(*a) * math.hypot(*b)
    angle = math.acos(min(abs(dot) / size, 1.0))
    if not angle:
        return a
    first = math.sin((1.0 - ratio) * angle) / math.sin(angle)
    second = math.copysign(math.sin(ratio * angle) / math.sin(angle), dot)
    x, y, z, w = (first * one + second * other for one, other in zip(a, b, strict=True))
    return x, y, z, w


def canonical(q: Quaternion) -> Quaternion:
    """Choose the unit quaternion of a rotation that tf2 returns.

    Of the two, it is the one whose w is positive, or whose largest other part is positive if the
    rotation is by 120 degrees or more: tf2 makes it from a matrix.
    """
    size = math.hypot(*q)
    x, y, z, w = (part / size for part in q)
    leading = w if 4.0 * w * w > 1.0 else max((x, y, z), key=abs)
    return (-x, -y, -z, -w) if leading < 0.0 else (x, y, z, w)


class Transformation(NamedTuple):
    """A frame's place in its parent frame at a time."""

    stamp_ns: int
    parent: str
    offset: Vector
    """Metres."""
    turn: Quaternion


class _Latest(NamedTuple):
    stamp_ns: int
    """The time of a frame's newest transform; 0: any time."""
    parent: str


L = TypeVar("L", Transformation, _Latest)


class StaticFrame:
    """A frame that never moves in its parent."""

    _only: Transformation  # none is made without a transform

    @property
    def latest(self) -> _Latest:
        """The time of the newest transform, and its parent."""
        return _Latest(0, self._only.parent)

    def add(self, transform: Transformation) -> bool:
        """Replace the transform."""
        self._only = transform
        return True

    def at(self, stamp_ns: int) -> Transformation:
        """Return the transform for any time."""
        return self._only._replace(stamp_ns=stamp_ns)


class FrameHistory:
    """The transforms of the `keep_ns` before the newest, by time."""

    def __init__(self, keep_ns: int) -> None:
        self._keep_ns = keep_ns
        self._stamps: list[int] = []
        self._known: list[Transformation] = []

    @property
    def latest(self) -> _Latest:
        """The time of the newest transform, and its parent."""
        return _Latest(self._stamps[-1], self._known[-1].parent)

    def add(self, transform: Transformation) -> bool:
        """Add a transform; return False for one that is too old to be kept."""
        stamps, known = self._stamps, self._known
        if stamps:
            oldest = stamps[-1] - self._keep_ns
            gone = bisect_left(stamps, oldest)
            del stamps[:gone], known[:gone]
            if transform.stamp_ns < oldest:
                return False
        place = bisect_right(stamps, transform.stamp_ns)
        if transform not in known[bisect_left(stamps, transform.stamp_ns) : place]:
            stamps.insert(place, transform.stamp_ns)
            known.insert(place, transform)
        return True

    def at(self, stamp_ns: int) -> Transformation:
        """Find or interpolate the transform at a time between the oldest and the newest.

        Between two parents it is the older one. Raise :class:`.ExtrapolationError`.
        """
        stamps, known = self._stamps, self._known
        if stamp_ns == stamps[-1]:
            return known[-1]
        if stamp_ns == stamps[0]:
            return known[0]
        if len(stamps) == 1:
            raise ExtrapolationError(
                f"Lookup would require extrapolation at time {_text(stamp_ns)}, "
                f"but only time {_text(stamps[0])} is in the buffer"
            )
        if not stamps[0] < stamp_ns < stamps[-1]:
            late = stamp_ns > stamps[-1]
            where, known_at = ("future", "latest") if late else ("past", "earliest")
            raise ExtrapolationError(
                f"Lookup would require extrapolation into the {where}.  Requested time "
                f"{_text(stamp_ns)} but the {known_at} data is at time {_text(stamps[-late])}"
            )
        place = bisect_right(stamps, stamp_ns)
        before, after = known[place - 1], known[place]
        return before if before.parent != after.parent else _between(before, after, stamp_ns)


def _between(before: Transformation, after: Transformation, stamp_ns: int) -> Transformation:
    ratio = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    x, y, z = (
        (1.0 - ratio) * one + ratio * other
        for one, other in zip(before.offset, after.offset, strict=True)
    )
    return Transformation(stamp_ns, before.parent, (x, y, z), slerp(before.turn, after.turn, ratio))


def _text(ns: int) -> str:
    """Format a time in seconds, as tf2 prints it."""
    return f"{ns // 1_000_000_000 + 1e-9 * (ns % 1_000_000_000):.6f}"


_JUMP_NS = 1_000_000_000  # back; two publishers of a frame are not so far apart
_DEEPEST = 1000  # frames above another one; more is a loop


class TransformBuffer:
    """Transforms between frames, of which each but the roots has a parent.

    It answers from what :meth:`add` got; one thread at a time. `keep_s` is how many seconds of each
    frame are kept, as in tf2.
    """

    def __init__(self, keep_s: float = 10.0) -> None:
        self._keep_ns = round(keep_s * 1e9)
        self._frames: dict[str, FrameHistory | StaticFrame] = {}
        self._roots: set[str] = set()
        """Frames that were a parent, and perhaps nothing else."""
        self._logged: set[tuple[str, str]] = set()

    def add(self, transform: TransformStamped, *, static: bool = False) -> bool:
        """Add where ``child_frame_id`` is in ``header.frame_id``, at that time or (`static`) ever.

        Return False for one that is ignored, as by tf2; why is logged once for each frame. A slash
        before a name is removed.
        """
        parent = transform.header.frame_id.removeprefix("/")
        child = transform.child_frame_id.removeprefix("/")
        offset, turn = transform.transform.translation, transform.transform.rotation
        new = Transformation(
            to_ns(transform.header.stamp),
            parent,
            (offset.x, offset.y, offset.z),
            (turn.x, turn.y, turn.z, turn.w),
        )
        if problem := _problem(child, new):
            return self._ignore(child, problem)
        new = new._replace(turn=canonical(new.turn))  # of any length, as tf2 takes it
        frame = self._frames.get(child)
        if frame is None or isinstance(frame, StaticFrame) is not static:
            frame = self._frames[child] = StaticFrame() if static else FrameHistory(self._keep_ns)
        self._roots.add(parent)  # as of a transform that is too old, too
        if not frame.add(new):
            return self._ignore(child, "TF_OLD_DATA: its time is too far in the past")
        return True

    def clear(self) -> None:
        """Forget all transforms but static ones, as tf2 does when time jumps back."""
        moving = [n for n, frame in self._frames.items() if isinstance(frame, FrameHistory)]
        for name in moving:
            del self._frames[name]

    def newest_ns(self, child: str) -> int | None:
        """Return the time of a moving frame's newest transform; None without one."""
        frame = self._frames.get(child.removeprefix("/"))
        return frame.latest.stamp_ns if isinstance(frame, FrameHistory) else None

    def lookup(self, target: str, source: str, at: Time = Time()) -> TransformStamped:  # noqa: B008 (immutable)
        """Find the transform that takes coordinates in `source` to coordinates in `target`.

        It is that at the time `at`, interpolated if necessary; its offset is in metres. Time 0 is
        the latest one at which all frames between the two are known. Raise :class:`.FrameNameError`
        for an empty name or a slash before it, :class:`.FrameLookupError` for an unknown frame,
        :class:`.ConnectivityError` for frames of different trees, and
        :class:`.ExtrapolationError` for a time before or after what is known.
        """
        at_ns = to_ns(at)
        if target == source:
            if not at_ns and target in self._frames:
                at_ns = self._frames[target].latest.stamp_ns
            return _stamped(at_ns, target, source, NO_OFFSET, IDENTITY)
        self._check("target_frame", target)
        self._check("source_frame", source)
        at_ns = at_ns or self._latest_common_ns(target, source)
        return _stamped(at_ns, target, source, *self._between(target, source, at_ns))

    def _ignore(self, child: str, problem: str) -> bool:
        kind = problem.partition(":")[0]
        if (child, kind) not in self._logged:
            self._logged.add((child, kind))
            _LOG.error("a transform of frame %r is ignored: %s", child, problem)
        return False

    def _check(self, argument: str, name: str) -> None:
        called = f"lookupTransform argument {argument}"
        if not name or name.startswith("/"):
            why = "start with a '/'" if name else "be empty"
            raise FrameNameError(
                f'Invalid argument "{name}" passed to {called} - in tf2 frame_ids cannot {why}'
            )
        if name not in self._frames and name not in self._roots:
            raise FrameLookupError(f'"{name}" passed to {called} does not exist. ')

    def _between(self, target: str, source: str, at_ns: int) -> tuple[Vector, Quaternion]:
        """Compose the transform from `source` to `target`, by way of the frame above both."""
        way = f", when looking up transform from frame [{source}] to frame [{target}]"
        up = _Way(source)
        unknown: ExtrapolationError | None = None
        try:
            for link in self._upwards(source, lambda frame: frame.at(at_ns)):
                up.add(link)
                if up.top == target:
                    return up.offset, up.turn
        except ExtrapolationError as error:  # there may still be a way below that frame
            unknown = error
        down = _Way(target)
        try:
            for link in self._upwards(target, lambda frame: frame.at(at_ns)):
                down.add(link)
                if down.top in (source, up.top):
                    break
        except ExtrapolationError as error:
            raise ExtrapolationError(f"{error}{way}") from None
        back = inverse(down.turn)
        x, y, z = down.offset
        offset = rotated(back, (-x, -y, -z))
        if down.top == source:
            return offset, back
        if down.top != up.top:
            if unknown is not None:
                raise ExtrapolationError(f"{unknown}{way}")
            raise _unconnected(target, source)
        return total(rotated(back, up.offset), offset), product(back, up.turn)

    def _upwards(self, frame: str, find: Callable[[FrameHistory | StaticFrame], L]) -> Iterator[L]:
        """Yield what is found of each frame from one to its root; raise as ``find`` does."""
        for _ in range(_DEEPEST + 1):
            known = self._frames.get(frame)
            if known is None:
                return
            link = find(known)
            yield link
            frame = link.parent
        raise FrameLookupError("The tf tree is invalid because it contains a loop.")

    def _latest_common_ns(self, target: str, source: str) -> int:
        """Find the latest time at which all frames between two are known; 0 if none moves."""
        above: list[_Latest] = []
        for latest in self._upwards(source, attrgetter("latest")):
            above.append(latest)
            if latest.parent == target:
                return _earliest(above)
        parents = [each.parent for each in above]
        below: list[_Latest] = []
        for latest in self._upwards(target, attrgetter("latest")):
            below.append(latest)
            if latest.parent in parents:
                return _earliest(below + above[: parents.index(latest.parent) + 1])
            if latest.parent == source:
                return _earliest(below)
        raise _unconnected(target, source)


class _Way:
    """The transform from a frame to one above it."""

    def __init__(self, frame: str) -> None:
        self.top = frame
        self.offset = NO_OFFSET
        self.turn = IDENTITY

    def add(self, link: Transformation) -> None:
        """Go one frame up."""
        self.top = link.parent
        self.offset = total(rotated(link.turn, self.offset), link.offset)
        self.turn = product(link.turn, self.turn)


def _problem(child: str, new: Transformation) -> str | None:
    if child == new.parent:
        return "TF_SELF_TRANSFORM: it is its own parent"
    if not child:
        return "TF_NO_CHILD_FRAME_ID: child_frame_id is empty"
    if not new.parent:
        return "TF_NO_FRAME_ID: header.frame_id is empty"
    if any(map(math.isnan, (*new.offset, *new.turn))):
        return "TF_NAN_INPUT: a number is NaN"
    if not 0.0 < sum(part * part for part in new.turn) < math.inf:
        return f"TF_DENORMALIZED_QUATERNION: {new.turn} is not a rotation"
    return None


def _earliest(latest: list[_Latest]) -> int:
    return min((each.stamp_ns for each in latest if each.stamp_ns), default=0)


def _stamped(
    at_ns: int, target: str, source: str, offset: Vector, turn: Quaternion
) -> TransformStamped:
    return TransformStamped(
        Header(from_ns(at_ns), target),
        source,
        Transform(Vector3(*offset), RosQuaternion(*canonical(turn))),
    )


def _unconnected(target: str, source: str) -> ConnectivityError:
    return ConnectivityError(
        f"Could not find a connection between '{target}' and '{source}' because they are not part "
        "of the same tree.Tf has two or more unconnected trees."
    )


class TransformListener:
    """Pulls the slots ``tf/FRAME`` and ``tf_static/FRAME`` of a board into a buffer.

    A slot holds the newest transform of its frame, so between two pulls the ones before are lost:
    pull as often as you want to interpolate. When time jumps back, as with a bag in a loop or a
    simulator that is reset, the buffer is cleared, which is logged: a transform of a frame is over
    a second older than the one before it.
    """

    def __init__(self, board: Board, buffer: TransformBuffer) -> None:
        self._board = board
        self._buffer = buffer
        self._changed = board.watcher()

    def pull(self) -> None:
        """Add the new transforms in the slots to the buffer.

        Raise :class:`.SlotTypeError` for a slot of such a name with another type, and
        :class:`.BoardClosedError`.
        """
        for name in self._changed(0.0):
            if name.startswith(("tf/", "tf_static/")):
                message = self._board[Slot(name, TransformStamped)].get()
                if message is not None:
                    is_static = name.startswith("tf_static/")
                    if not is_static and self._is_back(message):
                        _LOG.warning("Detected jump back in time. Clearing TF buffer.")
                        self._buffer.clear()
                    self._buffer.add(message, static=is_static)

    def _is_back(self, message: TransformStamped) -> bool:
        newest_ns = self._buffer.newest_ns(message.child_frame_id)
        return newest_ns is not None and to_ns(message.header.stamp) < newest_ns - _JUMP_NS
