"""Transforms between frames of coordinates, from the slots of a relay that is keyed by frame.

quaternions       rotations
frame_history     what is known of one frame: its transforms of the last seconds
transform_buffer  all frames as a tree, and the transform between any two
listener          reads the slots into a buffer
"""

from llfsm.bridges.ros2.transforms.buffer import TransformBuffer, TransformListener

__all__ = ["TransformBuffer", "TransformListener"]
