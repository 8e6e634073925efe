"""A ROS graph inside one process, for tests: no network, no ROS, the same rules.

Importable from every test: `from memory_transport import MemoryTransport, MemoryWorld`. It meets
the contract of every transport, which tests/bridges/ros2/test_transport_*.py check.

world      what transports share: the nodes and endpoints
topics     publishers and subscriptions
services   clients and servers
transport  all of it as a transport
"""

from .transport import MemoryTransport
from .world import MemoryWorld

__all__ = ["MemoryTransport", "MemoryWorld"]
