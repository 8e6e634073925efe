"""``llfsm bridge``: the command line of the ROS 2 bridge."""
