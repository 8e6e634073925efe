door = Sensor(DOOR, default=Door(), domain=DOORS)
time = Sensor(TIME_LEFT, default=TimeLeft())
motor = Actuator(MOTOR, at_end=Motor())
