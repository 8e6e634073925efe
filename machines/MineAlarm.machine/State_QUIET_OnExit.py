evacuate(Evacuate(now=True))
