"""ROS 2 over Zenoh, without ROS: the protocol of nodes with ``RMW_IMPLEMENTATION=rmw_zenoh_cpp``.

tokens       keys of messages, and liveliness tokens, which describe the graph
attachment   the metadata of each message
session      the configuration of a Zenoh session
receiving    callbacks on threads of ours
discovery    the graph, from tokens that come and go
endpoint     what publishers, subscriptions, clients and servers have in common
topics       publishers and subscriptions
services     clients and servers
transport    all of it as a transport
"""
