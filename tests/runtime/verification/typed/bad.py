"""Each line that is marked is a mistake that type checkers find."""

# pyright: strict

from boiler import HEAT, WATER, Boiler, Heat, Water, never_asleep

from llfsm.runtime import Machine, Sensor, State
from llfsm.runtime.verification import every, explore, verify


class Wrong(Machine):
    water = Sensor(WATER, default=Water(), domain=every(Water))
    other = Sensor(WATER, default=Water(), domain=every(Heat))  # wrong

    OFF = State()
    ON = State()

    @OFF.to(ON)
    def _(self) -> bool:
        return self.water.enuogh  # wrong

    @ON.internal
    def _(self) -> None:
        print(self.water.on)  # wrong


verify(Boiler, never_asleep, period="100")  # wrong
verify(Boiler, never_asleep, period_ms="100")  # wrong
verify(Boiler, never_asleep, any_time=1.5)  # wrong
verify(Boiler, lambda v: True, any_time=True)  # wrong
verify(Boiler, properties=never_asleep.name, any_time=True)  # wrong
verify(Boiler, sensors={WATER: 3}, any_time=True)  # wrong
verify(Boiler, sensors=[WATER], any_time=True)  # wrong
verify(Boiler, suspend=[Boiler], any_time=True)  # wrong
verify(Boiler, choices="turn", any_time=True)  # wrong
verify(Boiler, on_error="ignore", any_time=True)  # wrong
verify(Boiler, abstract={"Boiler.n": 3}, any_time=True)  # wrong
verify(Boiler, max_states=1.5, any_time=True)  # wrong
explore(Boiler, never_asleep, any_time=True)  # wrong
explore(Boiler, propertys=[never_asleep], any_time=True)  # wrong
explore(HEAT, any_time=True)  # wrong
print(verify(Boiler, any_time=True).state)  # wrong
print(every(Water)[0].on)  # wrong
