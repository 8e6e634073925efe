"""Connects a whiteboard with a ROS graph: relays between slots and topics, services in slots.

link            what a link has passed on so far, and what went wrong in it
echo_filter     which messages a relay of both directions has sent itself
relays          slot to topic, topic to slot
service_slots   a service's messages in slots: with a number, and a failure
slot_client     requests in a slot become calls of a ROS service
slot_server     requests of a ROS service go to a slot, answers back
turtle_position the turtle's position as a service, in ROS and on the board
bridge_config   what a configuration file may contain
bridge_plan     a configuration resolved to slots, topics and types, or its errors
bridge          all of it, running
"""

from .service_slots import ServiceSlots, service_slots

__all__ = ["ServiceSlots", "service_slots"]
