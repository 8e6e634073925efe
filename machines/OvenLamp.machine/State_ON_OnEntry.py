lamp(Lamp(on=True))
