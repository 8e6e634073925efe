pump(Pump(on=False))
