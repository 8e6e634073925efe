sound(Sound(on=False))
