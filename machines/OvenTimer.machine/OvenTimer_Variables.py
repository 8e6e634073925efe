door = Sensor(DOOR, default=Door(), domain=DOORS)
button = Sensor(BUTTON, default=Button(), domain=BUTTONS)
time = Sensor(TIME_LEFT, default=TimeLeft())
post_time = Actuator(TIME_LEFT)
minutes: int = 0
