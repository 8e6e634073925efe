"""What can be set of a relay while it runs: its rate, and whether it relays at all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from ..node_parameters import NodeParameters, Parameter
from .bridge_plan import RelayPlan

__all__ = ["RelaySettings", "declare_settings"]

_MOST_HZ = 1e6


class RelaySettings:
    """The settings of one relay, in both directions. One thread sets; any thread may read."""

    def __init__(self, period: float = 0.0) -> None:
        self.period = period
        """Seconds between two messages; 0: no limit."""
        self.enabled = True

    def set_rate(self, rate: float) -> None:
        """Let so many messages pass a second; 0: all."""
        self.period = 1 / rate if rate else 0.0

    def set_enabled(self, enabled: bool) -> None:
        """Let messages pass, or drop them."""
        self.enabled = enabled


def declare_settings(
    relays: Sequence[RelayPlan], parameters: NodeParameters
) -> list[RelaySettings]:
    """Declare ``relays.TOPIC.rate`` and ``.enabled``; return what they set, for each relay.

    Where several slots are relayed to one topic, it is ``TOPIC.SLOT``. Raise
    :class:`.ParameterOverrideError`.
    """
    relays_of = Counter(relay.topic for relay in relays)
    made = []
    for relay in relays:
        topic, slot = relay.topic, relay.slot.name
        name = topic if relays_of[topic] == 1 else f"{topic}.{slot}"
        settings = RelaySettings(relay.period)
        between = f"between {topic} and the slot {slot}"
        parameters.declare(
            {
                f"relays.{name}.rate": Parameter(
                    1 / relay.period if relay.period else 0.0,
                    f"Messages a second {between}, 0: no limit",
                    range=(0.0, _MOST_HZ),
                    changed=settings.set_rate,
                ),
                f"relays.{name}.enabled": Parameter(
                    True, f"Whether messages pass {between}", changed=settings.set_enabled
                ),
            }
        )
        made.append(settings)
    return made
