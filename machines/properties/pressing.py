"""Properties of the industrial press."""

from typing import Any

from llfsm.machines.press import PERMIT, RAM, PressHands, PressRam, Way
from llfsm.runtime.verification import leads_to, never, reachable, step

__all__ = [
    "PRESS",
    "both_hands",
    "closes",
    "closes_by_permit",
    "no_tied_button",
    "ram_obeys_slot",
    "release_opens",
]

PRESS = (PressHands, PressRam)


def _both(v: Any) -> bool:
    return bool(v.PressHands.hands.left and v.PressHands.hands.right)


both_hands = never(lambda v: v[PERMIT].close and not _both(v))
closes_by_permit = never(lambda v: v[RAM].way is Way.DOWN and not v.PressRam.permit.close)

ram_obeys_slot = never(lambda v: v[RAM].way is Way.DOWN and not v[PERMIT].close)
"""It does not hold: between the turns of the two machines the permit is gone, and the ram down."""

release_opens = leads_to(
    lambda v: v.PressHands.state == "BLOCKED", lambda v: v[RAM].way is not Way.DOWN, within_ms=0
)
"""In the same round."""

no_tied_button = step(
    lambda before, after: (
        before.PressHands.state != "BLOCKED"
        or after.PressHands.state == "BLOCKED"
        or not (after.PressHands.hands.left or after.PressHands.hands.right)
    )
)
"""After a stroke, the control waits until both buttons are released."""

closes = reachable(lambda v: v[RAM].way is Way.DOWN)
