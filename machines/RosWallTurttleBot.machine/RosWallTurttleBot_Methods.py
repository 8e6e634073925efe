def move(ahead: float, turn: float) -> None:
    """Post the command to drive at `ahead` m/s and turn at `turn` rad/s."""
    linear_x = ahead
    angular_z = turn
    drive(Twist(linear=Vector3(x=linear_x), angular=Vector3(z=angular_z)))


def ask_position() -> None:
    """Post a request with a number that no earlier request or answer has."""
    number = max(asked.number, answer.number) + 1
    ask(TurtlePositionRequest(number))
