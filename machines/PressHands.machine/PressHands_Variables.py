hands = Sensor(HANDS, default=Hands(), domain=ALL_HANDS)
permit = Actuator(PERMIT, at_end=Permit())
