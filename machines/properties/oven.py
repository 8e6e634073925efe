"""Properties of the one-minute microwave."""

from llfsm.machines.microwave import (
    DOOR,
    MOTOR,
    SOUND,
    OvenAlarm,
    OvenCooker,
    OvenLamp,
    OvenTimer,
    SafeOvenCooker,
)
from llfsm.runtime.verification import Member, always, leads_to, never, reachable

__all__ = [
    "OVEN",
    "SAFE_OVEN",
    "door_stops_motor",
    "fifteen_minutes",
    "lamp_shows_door",
    "minute_ends",
    "minute_ends_if_shut",
    "no_radiation",
    "off_is_off",
    "press_cooks",
    "rings",
    "rings_at_end",
]

OVEN = (OvenTimer, OvenCooker, OvenLamp, OvenAlarm)
SAFE_OVEN = (OvenTimer, Member(SafeOvenCooker, name="OvenCooker"), OvenLamp, OvenAlarm)

no_radiation = never(lambda v: v[DOOR].open and v[MOTOR].on)
"""It holds for neither oven: any machine may see the open door before the cooker has a turn."""

door_stops_motor = never(lambda v: v.OvenCooker.door.open and v[MOTOR].on)
"""It does not hold for `OVEN`: the motor stops in OFF's OnEntry, a round after that."""

off_is_off = never(lambda v: v.OvenCooker.state == "OFF" and v[MOTOR].on)
"""It does not hold for `OVEN`, for the same reason."""

fifteen_minutes = always(lambda v: 0 <= v.OvenTimer.minutes <= 15)
lamp_shows_door = never(lambda v: v.OvenLamp.door.open and v.OvenLamp.state == "OFF")
rings_at_end = leads_to(
    lambda v: v.OvenTimer.minutes == 0 and v.OvenAlarm.state == "ARMED", lambda v: v[SOUND].on
)

press_cooks = leads_to(lambda v: v.OvenTimer.button.pressed, lambda v: v[MOTOR].on)
"""It does not hold: the button may be pressed while the door is open."""

minute_ends = leads_to(lambda v: v.OvenTimer.minutes == 15, lambda v: v.OvenTimer.minutes < 15)
"""It does not hold: the door may stay open for ever."""

minute_ends_if_shut = leads_to(
    lambda v: v.OvenTimer.minutes == 15,
    lambda v: v.OvenTimer.minutes < 15,
    assuming=lambda v: not v.OvenTimer.door.open and not v.OvenTimer.button.pressed,
)
"""If the timer finds the door shut and the button released again and again."""

rings = reachable(lambda v: v[SOUND].on)
