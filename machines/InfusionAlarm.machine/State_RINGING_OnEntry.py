bell(Bell(on=True))
