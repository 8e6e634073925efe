water = Sensor(WATER, default=Water(), domain=WATERS)
pump = Sensor(PUMP, default=Pump())
failure = Actuator(PUMP_FAILURE)
