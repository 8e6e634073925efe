def move(ahead: float, turn: float) -> None:
    """Post the command to drive at `ahead` m/s and turn at `turn` rad/s."""
    linear_x = ahead
    angular_z = turn
    drive(Twist(linear=Vector3(x=linear_x), angular=Vector3(z=angular_z)))
