"""Offers and requests: the rule is DDS's."""

from __future__ import annotations

import pytest

from llfsm.bridges.ros2.qos import LivelinessPolicy, Qos

BY_TOPIC = LivelinessPolicy.MANUAL_BY_TOPIC
BY_NODE = LivelinessPolicy.MANUAL_BY_NODE


@pytest.mark.parametrize(
    ("requested", "offered", "reason"),
    [
        (Qos(deadline_ns=2), Qos(deadline_ns=2), None),
        (Qos(deadline_ns=2), Qos(deadline_ns=1), None),
        (Qos(), Qos(deadline_ns=1, lifespan_ns=1, liveliness=BY_TOPIC, lease_ns=1), None),
        (Qos(lifespan_ns=1), Qos(), None),  # only offered, never requested
        (Qos(deadline_ns=2_000_000_000), Qos(deadline_ns=2_000_000_001), "a deadline of 2 s"),
        (Qos(deadline_ns=2_000_000_000), Qos(), "a deadline of 2 s"),
        (Qos(lease_ns=500_000_000), Qos(), "a lease of 0.5 s"),
        (Qos(liveliness=BY_TOPIC), Qos(), "liveliness by topic, automatic is offered"),
        (Qos(liveliness=BY_TOPIC), Qos(liveliness=BY_NODE), "by topic, by node is offered"),
        (Qos(liveliness=BY_NODE), Qos(liveliness=BY_TOPIC), None),
    ],
)
def test_a_subscription_refuses_what_is_weaker_than_its_request(requested, offered, reason):
    refused = [why for _, why in requested.refused(offered)]
    assert (not refused) == (reason is None)
    assert (reason or "") in "; ".join(refused)
