"""Domains of ROS for this process of the tests: DDS has no router that keeps tests apart."""

from __future__ import annotations

import os

__all__ = ["own_domains"]

_EACH = 20
_DISTINCT = 5  # processes; ports of higher domains are those that Linux gives to anybody


def own_domains() -> range:
    """Return domains that no other process of the tests has, of the first five."""
    number = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % _DISTINCT
    return range(1 + number * _EACH, 1 + (number + 1) * _EACH)
