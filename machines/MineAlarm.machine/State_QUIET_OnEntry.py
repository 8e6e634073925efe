evacuate(Evacuate(now=False))
