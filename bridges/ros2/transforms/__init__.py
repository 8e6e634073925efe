"""Transforms between frames of coordinates, from the slots of a relay that is keyed by frame.

A listener reads the slots into a buffer, which answers for any two frames.
"""

from llfsm.bridges.ros2.transforms._buffer import TransformBuffer, TransformListener

__all__ = ["TransformBuffer", "TransformListener"]
