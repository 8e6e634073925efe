"""ROS 2 through rclpy, where a ROS environment is sourced: any middleware that it has.

api         the part of rclpy that is used, imported late
context     rclpy's context, the executor's thread, and the graph
endpoints   publishers, subscriptions, clients and servers
transport   all of it as a transport
"""
