"""Connects a whiteboard with a ROS graph: relays between slots and topics, services, actions.

bridge_config     a configuration as data, from a file or from flags
machine_config    the configuration that machines need themselves
bridge_plan       a configuration resolved to slots, topics and types, or its errors
bridge            all of it, running, and its health
relays            slot to topic, topic to slot
service_slots     the messages of services and actions in slots: with a number, and a failure
slot_service      a service called or answered through slots
slot_action       an action whose goals are sent or served through slots
turtle_position   the turtle's position as a service, in ROS and on the board
link              the counts and faults of one direction of any of these
ros_environment   machines with a bridge in their own process
managed_machines  machines as a managed node
"""

from llfsm.bridges.ros2.bridging.service_slots import (
    ActionSlots,
    ServiceSlots,
    action_slots,
    service_slots,
)

__all__ = ["ActionSlots", "ServiceSlots", "action_slots", "service_slots"]
