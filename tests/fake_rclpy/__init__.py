"""What of rclpy (Jazzy) the transport uses, without ROS: as strict as the original about its use.

Its messages are their bytes; the newest of them wait, as many as the depth says. A subscription is
served by the one who spins its node's executor, a destroyed entity raises InvalidHandle, the
response of a service must be of its class, and the context calls who waits for its shutdown while
it holds its lock.

world      what all share: the nodes, contexts and errors
qos        quality of service
entities   publishers, subscriptions, clients and services
node       nodes, and the graph of them
executor   the executor that serves the entities of its nodes
imports    the modules to be found instead of rclpy's
"""

from .imports import action_module, modules

__all__ = ["action_module", "modules"]
