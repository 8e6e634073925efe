"""A ROS graph inside one process, for tests and simulation: no network, no ROS, the same rules.

world     what transports share: who is there
topics    publishers and subscriptions
services  clients and servers
transport      all of it as a transport
"""

from .transport import MemoryTransport
from .world import MemoryWorld

__all__ = ["MemoryTransport", "MemoryWorld"]
