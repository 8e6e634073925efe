"""A whiteboard and a ROS graph, connected: relays between slots and topics, services in slots.

tally     what a link has done so far
echo      which messages a relay of both directions has sent itself
relays    slot to topic, topic to slot
numbered  a service's messages as slots have them: with a number, and a failure
calling   requests in a slot to calls of a ROS service
answering requests of a ROS service to a slot, answers back
position  where a turtle is, for those who ask in ROS or on the board
config    what a configuration file may say
planning  a configuration made into slots, topics and types, or what is wrong in it
presets   configurations that ship
bridge    all of it, running
"""

from .service_slots import ServiceSlots, service_slots

__all__ = ["ServiceSlots", "service_slots"]
