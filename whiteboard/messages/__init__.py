"""Message types that robots share, under their ROS names: a module a package, a class a type.

``from llfsm.whiteboard.messages.geometry_msgs import Twist``
"""
