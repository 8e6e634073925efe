"""Any ROS 2 type as an immutable Message class, with its bytes (CDR) and its hash (RIHS01).

types = TypeLibrary()
twist = types.message("geometry_msgs/msg/Twist")
assert twist.decode(twist.encode(twist.message())) == twist.message()
"""

from llfsm.bridges.ros2.types._library import RosAction, RosMessage, RosService, TypeLibrary

__all__ = ["RosAction", "RosMessage", "RosService", "TypeLibrary"]
