"""Connects a whiteboard with a ROS graph: relays between slots and topics, services in slots.

link            what a link has passed on so far, and what went wrong in it
echo_filter     which messages a relay of both directions has sent itself
relays          slot to topic, topic to slot
loss_watch      what is sent when the process is lost that commands a slot
key_path        where a message has a key
keyed_relay     topic to a slot for each key
service_slots   a service's messages in slots: with a number, and a failure
action_slots    an action's goals in slots, one at a time
slot_client     requests in a slot become calls of a ROS service
slot_server     requests of a ROS service go to a slot, answers back
slot_action_client   goals in a slot are sent to an action's server
slot_action_server   goals of an action go to a slot, and are ended there
turtle_position the turtle's position as a service, in ROS and on the board
bridge_config   what a configuration file may contain
bridge_plan     a configuration resolved to slots, topics and types, or its errors
bridge          all of it, running
"""

from llfsm.bridges.ros2.bridging.service_slots import (
    ActionSlots,
    ServiceSlots,
    action_slots,
    service_slots,
)

__all__ = ["ActionSlots", "ServiceSlots", "action_slots", "service_slots"]
