"""ROS 2 through rclpy, where a ROS environment is sourced: any middleware that it has.

api       the part of rclpy that is used, as types: it cannot be installed from PyPI
world     the context, the executor's thread, and the graph as rclpy tells it
topics    publishers and subscriptions, as bytes: our codec, not rclpy's, reads and writes them
services  clients and servers
transport      all of it as a transport
"""
