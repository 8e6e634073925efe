"""ROS 2 over Zenoh, without ROS: the protocol of nodes with ``RMW_IMPLEMENTATION=rmw_zenoh_cpp``.

graph        keys and liveliness tokens, and the graph that the tokens describe
endpoints    publishers, subscriptions, clients and servers
transport    the session, and all of it as a transport
"""
