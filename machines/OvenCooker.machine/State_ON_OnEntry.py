motor(Motor(on=True))
