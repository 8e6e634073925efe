"""The ROS 2 bridge: nodes on a ROS graph, with or without ROS installed."""
