bell(Bell(on=False))
