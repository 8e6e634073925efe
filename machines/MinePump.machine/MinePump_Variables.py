water = Sensor(WATER, default=Water(), domain=WATERS)
gas = Sensor(GAS, default=Gas(), domain=GASES)
operator = Sensor(OPERATOR, default=Operator(), domain=WISHES)
pump = Actuator(PUMP, at_end=Pump())
