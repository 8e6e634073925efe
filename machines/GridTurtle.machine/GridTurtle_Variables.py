command = Sensor(CMD_VEL, default=Twist())
request = Sensor(REQUEST, default=TurtlePositionRequest())
grip = Sensor(GRIP, default=Grip(), domain=GRIPS)
answer = Actuator(ANSWER)
forget = Actuator(REQUEST)
x: int = 2  # metres
y: int = 7
heading: int = 0  # eighths of a circle from the x axis, to the left
