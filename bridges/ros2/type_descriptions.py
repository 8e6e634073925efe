"""A node's service ``~/get_type_description``, which describes types to tools (REP 2011)."""

from __future__ import annotations

from typing import Any

from llfsm.whiteboard import Message

from .call_queue import Put, through
from .errors import RosTypeError
from .transport import Node, ServiceRequest
from .types import TypeLibrary

__all__ = ["TypeDescriptionServer"]


class TypeDescriptionServer:
    """Describes every type that its library knows, in use or not.

    On request it sends their sources, too. Requests are handled through ``put``.
    """

    def __init__(self, node: Node, types: TypeLibrary, put: Put) -> None:
        self._types = types
        of = types.service("type_description_interfaces/srv/GetTypeDescription")
        self._response = of.response.message
        self._classes: dict[str, type[Message]] = {
            name: types.message(f"type_description_interfaces/msg/{name}").message
            for name in (
                "TypeDescription",
                "IndividualTypeDescription",
                "Field",
                "FieldType",
                "TypeSource",
            )
        }
        node.server("~/get_type_description", of, through(put, self._answer))

    def _answer(self, request: ServiceRequest[Any, Any]) -> None:
        name, wanted = request.message.type_name, request.message.type_hash
        try:
            description, type_hash = self._types.describe(name)
        except RosTypeError as error:
            request.answer(self._response(failure_reason=str(error)))
            return
        if type_hash != wanted:
            reason = f"the hash of {name} is {type_hash} here"
            request.answer(self._response(failure_reason=reason))
            return
        whole = self._classes["TypeDescription"](
            type_description=self._individual(description["type_description"]),
            referenced_type_descriptions=tuple(
                map(self._individual, description["referenced_type_descriptions"])
            ),
        )
        sources = self._types.sources(name) if request.message.include_type_sources else []
        request.answer(
            self._response(
                successful=True,
                type_description=whole,
                type_sources=tuple(self._classes["TypeSource"](*source) for source in sources),
            )
        )

    def _individual(self, description: dict[str, Any]) -> Message:
        field, field_type = self._classes["Field"], self._classes["FieldType"]
        return self._classes["IndividualTypeDescription"](
            type_name=description["type_name"],
            fields=tuple(
                field(name=each["name"], type=field_type(**each["type"]))
                for each in description["fields"]
            ),
        )
