"""ROS 2 over Zenoh, without ROS: what nodes with ``RMW_IMPLEMENTATION=rmw_zenoh_cpp`` speak.

tokens       how the graph is told: keys and liveliness tokens
attachment   what goes with each message
session      how a Zenoh session is set up
discovery    the graph, from tokens that come and go
endpoint     what publishers, subscriptions, clients and servers have in common
topics       publishers and subscriptions
services     clients and servers
transport         all of it as a transport
"""
