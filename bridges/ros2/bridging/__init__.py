"""Connects a whiteboard with a ROS graph: relays between slots and topics, services, actions.

Read in this order: `bridge_config` and `machine_config` (a configuration as data), `bridge_plan`
(its slots, topics and types, or its errors), `relays`, `service_slots`, `slot_service`,
`slot_action` and `turtle_position` (what is connected), `bridge` (all of it, running, and its
health), then `ros_environment` and `managed_machines` (machines that are a node themselves).
"""

from llfsm.bridges.ros2.bridging.service_slots import (
    ActionSlots,
    ServiceSlots,
    action_slots,
    service_slots,
)

__all__ = ["ActionSlots", "ServiceSlots", "action_slots", "service_slots"]
