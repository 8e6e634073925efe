"""A user of turtlesim of zenoh-ros2-sdk, which knows our code as little as we know its.

ros_peer.py ROUTER_PORT DOMAIN HASHES: drives a turtle, calls services, sends a goal; then writes
what it saw as JSON. Messages within messages are written out flat: their bytes are the same.
"""

import json
import os
import sys
import threading
import traceback
from pathlib import Path

import numpy as np
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2Subscriber, ZenohSession

VECTOR3 = "float64 x\nfloat64 y\nfloat64 z\n"
TWIST = "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
POSE = "".join(
    f"float32 {name}\n" for name in ("x", "y", "theta", "linear_velocity", "angular_velocity")
)
EMPTY = "uint8 structure_needs_at_least_one_member\n"
SERVICES = {
    "turtlesim/srv/Spawn": ("float32 x\nfloat32 y\nfloat32 theta\nstring name\n", "string name\n"),
    "turtlesim/srv/Kill": ("string name\n", EMPTY),
    "rcl_interfaces/srv/ListParameters": (
        "string[] prefixes\nuint64 depth\n",
        "string[] names\nstring[] prefixes\n",
    ),
    "turtlesim/action/RotateAbsolute_SendGoal": (
        "uint8[16] goal_id\nfloat32 theta\n",
        "bool accepted\nint32 sec\nuint32 nanosec\n",
    ),
    "turtlesim/action/RotateAbsolute_GetResult": (
        "uint8[16] goal_id\n",
        "int8 status\nfloat32 delta\n",
    ),
}
PATIENCE = 20


def give_up(*error):
    traceback.print_exception(*error)
    os._exit(1)  # the sdk's threads would keep the process


sys.excepthook = give_up
router, domain = int(sys.argv[1]), int(sys.argv[2])
hashes = json.loads(Path(sys.argv[3]).read_text())
session = ZenohSession.get_instance(router_port=router)
Vector3 = session.register_message_type(VECTOR3, "geometry_msgs/msg/Vector3")
session.register_message_type(TWIST, "geometry_msgs/msg/Twist")
place = {"domain_id": domain, "router_port": router, "node_name": "peer"}
kept = []


def call(service, srv_type, **fields):
    request, response = SERVICES[srv_type]
    client = ROS2ServiceClient(
        service,
        srv_type,
        request_definition=request,
        response_definition=response,
        type_hash=hashes[srv_type],
        timeout=PATIENCE,
        **place,
    )
    answer = client.call(**fields)
    client.close()
    return answer


def listen(topic, msg_type, definition, callback):
    kept.append(
        ROS2Subscriber(
            topic,
            msg_type,
            callback=callback,
            msg_definition=definition,
            type_hash=hashes[msg_type],
            **place,
        )
    )


moving = threading.Event()
listen(
    "/turtle1/pose",
    "turtlesim/msg/Pose",
    POSE,
    lambda pose: moving.set() if pose.linear_velocity == 0.5 else None,
)
twist = ROS2Publisher(
    "/turtle1/cmd_vel",
    "geometry_msgs/msg/Twist",
    msg_definition=TWIST,
    type_hash=hashes["geometry_msgs/msg/Twist"],
    **place,
)
zero = Vector3(x=0.0, y=0.0, z=0.0)
for _ in range(PATIENCE * 10):  # until the publisher has met the subscription
    twist.publish(linear=Vector3(x=0.5, y=0.0, z=0.0), angular=zero)
    if moving.wait(0.1):
        break

place_of = {"x": 2.0, "y": 3.0, "theta": 0.5}
seen = {
    "moved": moving.is_set(),
    "spawned": [
        call("/spawn", "turtlesim/srv/Spawn", **place_of, name=name).name
        for name in ("bob", "bob", "bad name!", "")
    ],
    "killed": call("/kill", "turtlesim/srv/Kill", name="bob") is not None,
}
listed = call(
    "/turtlesim/list_parameters", "rcl_interfaces/srv/ListParameters", prefixes=[], depth=0
)
seen["parameters"] = list(listed.names)

goal_id = np.arange(1, 17, dtype=np.uint8)
action = "/turtle2/rotate_absolute/_action"
remaining = []
listen(
    f"{action}/feedback",
    "turtlesim/action/RotateAbsolute_FeedbackMessage",
    "uint8[16] goal_id\nfloat32 remaining\n",
    lambda feedback: remaining.append((list(map(int, feedback.goal_id)), feedback.remaining)),
)
kind = "turtlesim/action/RotateAbsolute"
sent = call(f"{action}/send_goal", f"{kind}_SendGoal", goal_id=goal_id, theta=0.8)
ended = call(f"{action}/get_result", f"{kind}_GetResult", goal_id=goal_id)
seen["accepted"] = bool(sent.accepted)
seen["status"], seen["delta"] = int(ended.status), float(ended.delta)
seen["ids"] = sorted({tuple(each) for each, _ in remaining})
seen["feedback"] = [float(left) for _, left in remaining]
print(json.dumps(seen), flush=True)
os._exit(0)
