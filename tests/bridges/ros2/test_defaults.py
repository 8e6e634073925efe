"""Which transport and domain are used where nobody names one."""

from __future__ import annotations

import importlib.util

import pytest

from llfsm.bridges.ros2.errors import DomainIdError
from llfsm.bridges.ros2.opening import choose_transport, needs_router
from llfsm.bridges.ros2.transport import check_domain, default_domain


@pytest.mark.parametrize(
    ("installed", "router", "chosen"),
    [
        (True, False, "rclpy"),
        (True, True, "zenoh"),
        (False, False, "zenoh"),
        (False, True, "zenoh"),
    ],
)
def test_auto_is_rclpy_where_it_is_installed_and_no_router_is_named(
    monkeypatch, installed, router, chosen
):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: installed or None)
    assert choose_transport("auto", router=router) == chosen
    assert choose_transport("zenoh", router=router) == "zenoh"


@pytest.mark.parametrize(
    ("name", "rmw", "needed"),
    [
        ("zenoh", "rmw_fastrtps_cpp", True),
        ("rclpy", "rmw_fastrtps_cpp", False),
        ("rclpy", "rmw_zenoh_cpp", True),
    ],
)
def test_a_router_is_needed_where_zenoh_carries_the_messages(monkeypatch, name, rmw, needed):
    monkeypatch.setenv("RMW_IMPLEMENTATION", rmw)
    assert needs_router(name, router=False) is needed


def test_the_domain_is_what_the_environment_says(monkeypatch):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert default_domain() == 0
    monkeypatch.setenv("ROS_DOMAIN_ID", "")
    assert default_domain() == 0
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert default_domain() == 42


@pytest.mark.parametrize("text", ["x", "-1", "233", "1.5"])
def test_a_domain_of_the_environment_that_is_none_is_refused(monkeypatch, text):
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(DomainIdError, match="ROS_DOMAIN_ID='" + text):
        default_domain()


@pytest.mark.parametrize("domain", [-1, 233])
def test_a_domain_that_is_none_is_refused(domain):
    with pytest.raises(DomainIdError, match=str(domain)):
        check_domain(domain)
