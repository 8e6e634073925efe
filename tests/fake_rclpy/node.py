"""Nodes, and the graph of them."""

from __future__ import annotations

from types import SimpleNamespace

from .entities import CallbackGroup, Client, Publisher, Service, Subscription
from .qos import DurabilityPolicy, profile, reaches
from .world import CHANGED, NODES, NodeNameNonExistentError


class Node:
    def __init__(self, name, *, namespace, context, parameter_overrides, **options):
        assert options == {
            "use_global_arguments": False,
            "enable_rosout": False,
            "start_parameter_services": False,
        }
        assert [(p.name, p.value) for p in parameter_overrides] == [
            ("start_type_description_service", False)
        ]
        self.name, self.namespace, self.context, self.ends = name, namespace, context, []
        self.callback_group = CallbackGroup()
        with CHANGED:
            NODES.append(self)
        events = SimpleNamespace(ros_name="rcl_interfaces/msg/ParameterEvent")
        self._make(Publisher, "publisher", events, "/parameter_events", profile())

    def _make(self, of, *what):
        end = of(self, *what)
        with CHANGED:
            self.ends.append(end)
            CHANGED.notify_all()
        return end

    def create_publisher(self, msg_type, topic, qos_profile, *, event_callbacks):
        event_callbacks.check()
        end = self._make(Publisher, "publisher", msg_type, topic, qos_profile)
        end.events = event_callbacks
        return end

    def create_subscription(self, msg_type, topic, callback, qos_profile, *, event_callbacks, raw):
        event_callbacks.check()
        assert raw
        with CHANGED:
            end = self._make(Subscription, "subscription", msg_type, topic, qos_profile)
            end.callback, end.events = callback, event_callbacks
            if qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
                for publisher in end.others("publisher"):
                    end.waiting.extend(publisher.past if reaches(publisher, end) else ())
        return end

    def create_client(self, srv_type, srv_name, *, qos_profile):
        return self._make(Client, "client", srv_type, srv_name, qos_profile)

    def create_service(self, srv_type, srv_name, callback, *, qos_profile):
        end = self._make(Service, "server", srv_type, srv_name, qos_profile)
        end.callback = callback
        return end

    def _destroy(self, end):
        with CHANGED:
            there, end.destroyed = not end.destroyed, True
            if there:
                self.ends.remove(end)
            return there

    destroy_publisher = destroy_subscription = destroy_client = destroy_service = _destroy

    def destroy_node(self):
        with CHANGED:
            NODES.remove(self)

    def _nodes(self):
        return [node for node in NODES if node.context.domain == self.context.domain]

    publishers = property(lambda self: self._of_kind("publisher"))
    subscriptions = property(lambda self: self._of_kind("subscription"))
    clients = property(lambda self: self._of_kind("client"))
    services = property(lambda self: self._of_kind("server"))

    def _of_kind(self, kind):
        return [end for end in self.ends if end.kind == kind]

    def get_node_names_and_namespaces(self):
        return [(node.name, node.namespace) for node in self._nodes()]

    def get_topic_names_and_types(self):
        kinds = ("publisher", "subscription")
        ends = [end for node in self._nodes() for end in node.ends if end.kind in kinds]
        return [(name, []) for name in {end.name for end in ends}]

    def _infos(self, kind, topic):
        return [
            SimpleNamespace(
                node_name=node.name,
                node_namespace=node.namespace,
                topic_type=end.cls.ros_name,
                topic_type_hash=getattr(end.cls, "type_hash", "INVALID"),
                qos_profile=end.qos,
            )
            for node in self._nodes()
            for end in node.ends
            if (end.kind, end.name) == (kind, topic)
        ]

    def get_publishers_info_by_topic(self, topic_name):
        return self._infos("publisher", topic_name)

    def get_subscriptions_info_by_topic(self, topic_name):
        return self._infos("subscription", topic_name)

    def _of_node(self, kind, name, namespace):
        for node in self._nodes():
            if (node.name, node.namespace) == (name, namespace):
                return [(end.name, [end.cls.ros_name]) for end in node.ends if end.kind == kind]
        raise NodeNameNonExistentError

    def get_service_names_and_types_by_node(self, name, namespace):
        return self._of_node("server", name, namespace)

    def get_client_names_and_types_by_node(self, name, namespace):
        return self._of_node("client", name, namespace)
