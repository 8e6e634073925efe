bell(AlarmBell(on=False))
