sound(Sound(on=True))
