"""An independent ROS 2 node over Zenoh, of zenoh-ros2-sdk, told what to do line by line.

peer.py ROUTER_PORT DOMAIN HASHES: reads [command, argument ...] as JSON, writes [event, ...].
"""

import json
import sys
import threading
from pathlib import Path

from zenoh_ros2_sdk import (
    ROS2Publisher,
    ROS2ServiceClient,
    ROS2ServiceServer,
    ROS2Subscriber,
    ZenohSession,
    get_service_info,
    get_topic_info,
)

VECTOR3 = "float64 x\nfloat64 y\nfloat64 z\n"
TWIST = "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
SPAWN = ("float32 x\nfloat32 y\nfloat32 theta\nstring name\n", "string name\n")

router, domain = int(sys.argv[1]), int(sys.argv[2])
hashes = json.loads(Path(sys.argv[3]).read_text())
session = ZenohSession.get_instance(router_port=router)
Vector3 = session.register_message_type(VECTOR3, "geometry_msgs/msg/Vector3")
session.register_message_type(TWIST, "geometry_msgs/msg/Twist")
place = {"domain_id": domain, "router_port": router}
twist = {
    "msg_type": "geometry_msgs/msg/Twist",
    "msg_definition": TWIST,
    "type_hash": hashes["geometry_msgs/msg/Twist"],
}
spawn = {
    "srv_type": "turtlesim/srv/Spawn",
    "request_definition": SPAWN[0],
    "response_definition": SPAWN[1],
    "type_hash": hashes["turtlesim/srv/Spawn"],
}
writing = threading.Lock()
kept = []


def tell(*event):
    with writing:
        print(json.dumps(event), flush=True)


def serve(request):
    response = session.store.types[server.response_store_type]
    return response(name=f"{request.name} at {request.x}")


def look(get, name, roles, count):
    """Tell of a topic's or service's ends, when so many are found: one query may find none."""
    for _ in range(40):
        found = get(name, **place, verbose=True)
        ends = {
            role: [(end.node_namespace, end.node_name, end.type_hash, end.qos) for end in ends]
            for role in roles
            if (ends := getattr(found, role, None)) is not None
        }
        if sum(map(len, ends.values())) == count:
            break
    tell("info", ends)


for line in sys.stdin:
    command, *arguments = json.loads(line)
    if command == "publisher":
        kept.append(publisher := ROS2Publisher(arguments[0], **twist, node_name="peer", **place))
    elif command == "publish":
        x, z = arguments
        publisher.publish(linear=Vector3(x=x, y=0.0, z=0.0), angular=Vector3(x=0.0, y=0.0, z=z))
    elif command == "subscriber":
        kept.append(
            ROS2Subscriber(
                arguments[0],
                callback=lambda message: tell("message", message.linear.x, message.angular.z),
                **twist,
                node_name="peer",
                **place,
                qos=arguments[1],
            )
        )
    elif command == "server":
        kept.append(
            server := ROS2ServiceServer(
                arguments[0], callback=serve, **spawn, node_name="peer", **place
            )
        )
    elif command == "client":
        kept.append(client := ROS2ServiceClient(arguments[0], **spawn, node_name="peer", **place))
    elif command == "call":
        answer = client.call(x=arguments[0], y=0.0, theta=0.0, name=arguments[1])
        tell("answer", answer and answer.name)
    elif command == "topic":
        look(get_topic_info, arguments[0], ("publishers", "subscribers"), arguments[1])
    elif command == "service":
        look(get_service_info, arguments[0], ("servers", "clients"), arguments[1])
    tell("done", command)
