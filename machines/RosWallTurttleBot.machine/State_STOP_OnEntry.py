move(0.0, 0.0)
ask_position()
