drive = Actuator(Slot("turtle1/cmd_vel", Twist), at_end=Twist())
linear_x: float = 0.0  # m/s
angular_z: float = 0.0  # rad/s
