"""Every service call recorded from turtlesim 1.8.2 gets the same answer, log and poses."""

import re

from llfsm.bridges.turtlesim.simulator import Simulator
from llfsm.bridges.turtlesim.turtle import Level

LINE = re.compile(r"\[(\w+)\] \[[\d.]+\] \[turtlesim\]: (.*)")


def call(simulator, service, request):
    """Do what a node does for a request: the services of a turtle stand under its name."""
    *turtle, name = service.strip("/").split("/")
    answer = getattr(simulator, name)(*turtle, **request)
    return {} if answer is None else {"name": answer}


def test_recorded_services(recorded, simulator, log):
    calls = 0
    for record in recorded("turtlesim_services.json"):
        if record["label"] == "turtlesim_node alive after the illegal name":
            assert not record["alive"]  # ours lives; the recording goes on with a new node
            simulator = Simulator(log=lambda level, text: log.append((level, text)))
        elif record["label"] == "spawn with an illegal name":
            log.clear()
            turtles = list(simulator.turtles)
            assert call(simulator, record["service"], record["request"]) == {"name": ""}
            ((level, text),) = log
            assert level is Level.ERROR
            assert "'bad name!'" in text
            assert "letters, digits and '_'" in text
            simulator.step()
            assert list(simulator.turtles) == turtles
        elif "service" in record:
            log.clear()
            assert call(simulator, record["service"], record["request"]) == record["response"]
            for _ in range(3):
                simulator.step()
            expected = [LINE.fullmatch(line).groups() for line in record["log"]]
            assert [(level.name, text) for level, text in log] == expected, record["label"]
            calls += 1
        for name, pose in poses_of(record).items():
            assert simulator.turtle(name).pose._asdict() == pose, record["label"]
        if isinstance(turtles := record.get("turtles"), list):
            assert list(simulator.turtles) == turtles, record["label"]
    assert calls == 20


def poses_of(record):
    """Return all poses that a record holds, by turtle."""
    turtle1 = record.get("turtle1_pose_after") or record.get("pose")
    return record.get("poses", {}) | ({"turtle1": turtle1} if turtle1 else {})
