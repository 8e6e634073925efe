"""The parts of services and actions, as in ROS's type descriptions (REP 2011).

A service is a request, a response and, for introspection, an event. An action is a goal, a
result and a feedback, two services and a message that carries the feedback.
"""

from __future__ import annotations

from .definition import Constant, Definition, Field, FieldType, Shape

__all__ = ["action_definitions", "service_definitions"]

_Body = tuple[tuple[Field, ...], tuple[Constant, ...]]

_GOAL_ID = Field("goal_id", FieldType("unique_identifier_msgs/msg/UUID"))


def service_definitions(name: str, request: _Body, response: _Body) -> list[Definition]:
    """Return a service's definitions: itself, its request, response and event."""
    asked, answered, event = (f"{name}_{part}" for part in ("Request", "Response", "Event"))
    return [
        Definition(asked, *request),
        Definition(answered, *response),
        Definition(
            event,
            (
                Field("info", FieldType("service_msgs/msg/ServiceEventInfo")),
                Field("request", FieldType(asked, Shape.BOUNDED, 1)),
                Field("response", FieldType(answered, Shape.BOUNDED, 1)),
            ),
        ),
        Definition(
            name,
            (
                Field("request_message", FieldType(asked)),
                Field("response_message", FieldType(answered)),
                Field("event_message", FieldType(event)),
            ),
            kind="service",
        ),
    ]


def action_definitions(name: str, goal: _Body, result: _Body, feedback: _Body) -> list[Definition]:
    """Return an action's definitions: itself and all its parts, those of its services included."""
    parts = ("Goal", "Result", "Feedback", "SendGoal", "GetResult", "FeedbackMessage")
    goals, results, feedbacks, send_goal, get_result, message = (f"{name}_{p}" for p in parts)
    accepted = (
        Field("accepted", FieldType("bool")),
        Field("stamp", FieldType("builtin_interfaces/msg/Time")),
    )
    ended = (Field("status", FieldType("int8")), Field("result", FieldType(results)))
    return [
        Definition(goals, *goal),
        Definition(results, *result),
        Definition(feedbacks, *feedback),
        *service_definitions(
            send_goal, ((_GOAL_ID, Field("goal", FieldType(goals))), ()), (accepted, ())
        ),
        *service_definitions(get_result, ((_GOAL_ID,), ()), (ended, ())),
        Definition(message, (_GOAL_ID, Field("feedback", FieldType(feedbacks)))),
        Definition(
            name,
            (
                Field("goal", FieldType(goals)),
                Field("result", FieldType(results)),
                Field("feedback", FieldType(feedbacks)),
                Field("send_goal_service", FieldType(send_goal)),
                Field("get_result_service", FieldType(get_result)),
                Field("feedback_message", FieldType(message)),
            ),
            kind="action",
        ),
    ]
