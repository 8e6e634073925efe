"""Bridges between the whiteboard and other worlds: simulators, ROS 2, the browser."""
