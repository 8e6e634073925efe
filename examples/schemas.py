"""Print what a C program must know of slots: name, type, schema, fingerprint, capacity.

python examples/schemas.py > examples/schemas.h
"""

import json

import msgspec

from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages import geometry_msgs, turtlesim

SLOTS = {
    "CMD_VEL": Slot("turtle1/cmd_vel", geometry_msgs.Twist),
    "POSE": Slot("turtle1/pose", turtlesim.Pose),
}

print("/* Made by schemas.py. */")
for name, slot in SLOTS.items():
    schema = msgspec.json.encode(slot.schema).decode()
    print(
        f"static const struct lwb_schema {name} = {{\n"
        f"    {json.dumps(slot.name)}, {json.dumps(slot.type_name)},\n"
        f"    {json.dumps(schema)},\n"
        f"    {slot.fingerprint:#x}u, {slot.capacity}}};"
    )
