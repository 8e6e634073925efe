"""Message types shared by robots, under their ROS names: a module a package, a class a type.

``from llfsm.whiteboard.messages.geometry_msgs import Twist``
"""
