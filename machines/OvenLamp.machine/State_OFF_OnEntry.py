lamp(Lamp(on=False))
