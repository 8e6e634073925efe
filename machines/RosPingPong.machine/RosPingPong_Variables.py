publish = Actuator(Slot("pinpong", String))
count: int = 0
