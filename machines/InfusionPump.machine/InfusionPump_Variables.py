panel = Sensor(PANEL, default=Panel(), domain=PANELS)
fault = Sensor(FAULT, default=Fault(), domain=FAULTS)
drug = Actuator(DRUG, at_end=Drug())
