"""Rotations as quaternions (x, y, z, w), computed as tf2 does."""

from __future__ import annotations

import math
from typing import TypeAlias

__all__ = [
    "IDENTITY",
    "NO_OFFSET",
    "Quaternion",
    "Vector",
    "canonical",
    "inverse",
    "product",
    "rotated",
    "slerp",
    "total",
]

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

NO_OFFSET: Vector = (0.0, 0.0, 0.0)
IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation by `b`, then by `a`."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by + ay * bw + az * bx - ax * bz,
        aw * bz + az * bw + ax * by - ay * bx,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def inverse(q: Quaternion) -> Quaternion:
    """Return the opposite rotation of a unit quaternion."""
    x, y, z, w = q
    return -x, -y, -z, w


def rotated(q: Quaternion, v: Vector) -> Vector:
    """Return a vector rotated by a unit quaternion."""
    x, y, z, _ = product(product(q, (*v, 0.0)), inverse(q))
    return x, y, z


def total(a: Vector, b: Vector) -> Vector:
    """Return the sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def slerp(a: Quaternion, b: Quaternion, ratio: float) -> Quaternion:
    """Return the rotation at `ratio`, from 0 to 1, of the shorter way from `a` to `b`."""
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
    """Return the unit quaternion of the same rotation that tf2 returns.

    Of the two, it is the one whose w is positive, or whose largest other part is positive if the
    rotation is by 120 degrees or more: tf2 makes it from a matrix.
    """
    size = math.hypot(*q)
    x, y, z, w = (part / size for part in q)
    leading = w if 4.0 * w * w > 1.0 else max((x, y, z), key=abs)
    return (-x, -y, -z, -w) if leading < 0.0 else (x, y, z, w)
