drive = Actuator(Slot("turtle1/cmd_vel", Twist), at_end=Twist())
ask = Actuator(REQUEST)
asked = Sensor(REQUEST, default=TurtlePositionRequest())
answer = Sensor(ANSWER, default=TurtlePositionAnswer())
linear_x: float = 0.0  # m/s
angular_z: float = 0.0  # rad/s
number: int = 0  # of the latest request
pos_x: int = 0  # whole metres
pos_y: int = 0
