gas = Sensor(GAS, default=Gas(), domain=GASES)
failure = Sensor(PUMP_FAILURE, default=PumpFailure())
evacuate = Actuator(EVACUATE, at_failure=Evacuate(now=True))
