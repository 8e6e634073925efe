pump(Pump(on=True))
