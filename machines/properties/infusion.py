"""Properties of the infusion pump."""

from llfsm.machines.infusion_pump import BELL, DRUG, Drug, InfusionAlarm, InfusionPump, Key, Rate
from llfsm.runtime import Machine, Sensor, State
from llfsm.runtime.verification import leads_to, monitor, never, reachable, step

__all__ = [
    "INFUSION",
    "BolusWatch",
    "bolus_ends",
    "bolus_is_asked_for",
    "bolus_is_given",
    "boluses_apart",
    "fault_rings",
    "fault_stops_drug",
    "locked_after_bolus",
    "ringing_is_heard",
    "stop_stops_drug",
]

INFUSION = (InfusionPump, InfusionAlarm)

fault_stops_drug = never(lambda v: v.InfusionPump.fault.present and v[DRUG].rate is not Rate.NONE)
stop_stops_drug = never(
    lambda v: v.InfusionPump.panel.key is Key.STOP and v[DRUG].rate is not Rate.NONE
)
fault_rings = never(lambda v: v.InfusionAlarm.fault.present and v.InfusionAlarm.state == "QUIET")
ringing_is_heard = step(
    lambda before, after: (
        (before.InfusionAlarm.state, after.InfusionAlarm.state) != ("QUIET", "RINGING")
        or after[BELL].on
    )
)

bolus_is_asked_for = step(
    lambda before, after: (
        (before.InfusionPump.state, after.InfusionPump.state) != ("INFUSING", "BOLUS")
        or after.InfusionPump.panel.key is Key.BOLUS
    )
)
bolus_ends = leads_to(
    lambda v: v[DRUG].rate is Rate.BOLUS, lambda v: v[DRUG].rate is not Rate.BOLUS, within_ms=6000
)


class BolusWatch(Machine):
    """Find a bolus that begins less than thirty seconds after the end of another one."""

    drug = Sensor(DRUG, default=Drug())

    FREE = State()
    GIVEN = State()
    PAUSE = State()
    TOO_SOON = State()

    FREE.to(GIVEN, when=lambda self: self.drug.rate is Rate.BOLUS)
    GIVEN.to(PAUSE, when=lambda self: self.drug.rate is not Rate.BOLUS)
    PAUSE.to(FREE, after_ms=30_000)
    PAUSE.to(TOO_SOON, when=lambda self: self.drug.rate is Rate.BOLUS)


boluses_apart = monitor(BolusWatch, BolusWatch.TOO_SOON)
locked_after_bolus = step(
    lambda before, after: (
        before.InfusionPump.state != "BOLUS" or after.InfusionPump.state != "INFUSING"
    )
)
bolus_is_given = reachable(lambda v: v[DRUG].rate is Rate.BOLUS)
