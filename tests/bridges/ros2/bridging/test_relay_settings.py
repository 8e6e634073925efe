"""What can be set of a relay while it runs follows the parameters of the bridge's node."""

from __future__ import annotations

from pathlib import Path

import pytest

from llfsm.bridges.ros2.bridging._relays import declare_settings
from llfsm.bridges.ros2.bridging.bridge_config import BridgeConfig, RelayConfig
from llfsm.bridges.ros2.bridging.bridge_plan import make_plan
from llfsm.bridges.ros2.node_parameters import NodeParameters


@pytest.fixture
def relays():
    relay = RelayConfig(slot="n", type="std_msgs/msg/Int64", direction="to_ros", rate=4)
    plan, faults = make_plan(BridgeConfig(relay=(relay,)), Path(), [])
    assert not faults
    return plan.relays


def test_the_period_follows_the_rate(relays):
    parameters = NodeParameters()
    (settings,) = declare_settings(relays, parameters)
    assert (parameters.values()["relays./n.rate"], settings.period) == (4.0, 0.25)
    for rate, period in ((10.0, 0.1), (0.0, 0.0)):
        parameters.assign("relays./n.rate", rate)
        assert settings.period == period


def test_it_begins_with_what_arguments_say(relays):
    parameters = NodeParameters()
    parameters.override({"relays./n.rate": 5.0, "relays./n.enabled": False})
    (settings,) = declare_settings(relays, parameters)
    assert (settings.period, settings.enabled) == (0.2, False)
