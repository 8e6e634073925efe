time = Sensor(TIME_LEFT, default=TimeLeft())
sound = Actuator(SOUND, at_end=Sound())
