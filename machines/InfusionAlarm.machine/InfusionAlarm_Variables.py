panel = Sensor(PANEL, default=Panel(), domain=PANELS)
fault = Sensor(FAULT, default=Fault(), domain=FAULTS)
bell = Actuator(BELL, at_failure=AlarmBell(on=True))
