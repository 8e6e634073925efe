"""What a node logs appears on /rosout, as rcl publishes it."""

from __future__ import annotations

import logging

import pytest

from llfsm.bridges.ros2.graph import Role
from llfsm.bridges.ros2.qos import DurabilityPolicy, Qos
from llfsm.bridges.ros2.standard_node import Rosout
from memory_transport import MemoryTransport, MemoryWorld


@pytest.fixture
def rosout(types, seen):
    """Return a node's log, and list what another node reads of it."""
    world, got = MemoryWorld(), seen()
    with MemoryTransport(world) as ours, MemoryTransport(world) as theirs:
        line = types.message("rcl_interfaces/msg/Log")
        late = Qos(durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=100)
        out = Rosout(ours.node("robot", "/a/b"), types)
        theirs.node("tool").subscription("/rosout", line, lambda a: got(a.decode()), late)
        out.got, out.transport = got, ours
        yield out


def test_a_record_has_its_file_its_function_its_line_and_the_nodes_name(rosout):
    logger = logging.Logger("any")
    logger.addHandler(rosout)
    logger.warning("%d of %s", 3, "four")
    rosout.got.wait(len)
    (line,) = rosout.got
    assert (line.level, line.name, line.msg) == (30, "a.b.robot", "3 of four")
    assert line.file == __file__
    assert line.function.startswith("test_a_record_has")
    assert line.line > 0
    assert line.stamp.sec > 1_600_000_000


def test_lines_are_valid_for_ten_seconds(rosout):
    (end,) = rosout.transport.graph().ends("/rosout", Role.PUBLISHER)
    assert end.qos == Qos(
        durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=1000, lifespan_ns=10_000_000_000
    )


def test_a_line_that_cannot_be_published_is_no_error_of_its_logger(rosout, monkeypatch, types):
    monkeypatch.setattr(logging, "raiseExceptions", False)
    logger = logging.Logger("any")
    logger.addHandler(rosout)
    logger.error("a text that ROS cannot carry: \ud800")
    logger.error("after")
    rosout.got.wait(len)
    assert [line.msg for line in rosout.got] == ["after"]
    rosout.transport.close()
    logger.error("to nobody")


class LoggingNode:
    """A node whose publisher logs what it publishes, which is a fault."""

    name = "/a/b/robot"

    def __init__(self):
        self.logger, self.lines = logging.Logger("any"), []

    def publisher(self, topic, of, qos):
        return self

    def publish(self, line):
        self.lines.append(line.msg)
        self.logger.error("a fault of publishing")


def test_what_publishing_itself_logs_is_not_published(types):
    node = LoggingNode()
    node.logger.addHandler(Rosout(node, types))
    node.logger.error("first")
    node.logger.error("second")
    assert node.lines == ["first", "second"]
