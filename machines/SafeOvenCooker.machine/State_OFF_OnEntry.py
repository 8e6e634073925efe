motor(Motor(on=False))
