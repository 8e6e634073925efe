linear_x = angular_z = 0.0
