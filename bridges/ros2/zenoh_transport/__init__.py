"""ROS 2 over Zenoh, without ROS: the protocol of nodes with ``RMW_IMPLEMENTATION=rmw_zenoh_cpp``.

Read in this order: `graph` (keys and tokens), `endpoints`, `transport`.
"""
