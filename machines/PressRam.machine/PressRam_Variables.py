permit = Sensor(PERMIT, default=Permit())
at = Sensor(RAM_POSITION, default=RamPosition(), domain=POSITIONS)
ram = Actuator(RAM, at_end=Ram())
