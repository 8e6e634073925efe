door = Sensor(DOOR, default=Door(), domain=DOORS)
time = Sensor(TIME_LEFT, default=TimeLeft())
lamp = Actuator(LAMP, at_end=Lamp())
