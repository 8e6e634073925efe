"""ROS 2 through rclpy, where a ROS environment is sourced: any middleware that it has.

Read in this order: `api` (what is used of rclpy), `context`, `endpoints`, `transport`.
"""
