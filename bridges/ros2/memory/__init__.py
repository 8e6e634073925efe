"""A ROS graph inside one process, for tests and simulation: no network, no ROS, the same rules.

world     what ports share: who is there
topics    publishers and subscriptions
services  clients and servers
port      all of it as a port
"""

from .port import MemoryPort
from .world import MemoryWorld

__all__ = ["MemoryPort", "MemoryWorld"]
