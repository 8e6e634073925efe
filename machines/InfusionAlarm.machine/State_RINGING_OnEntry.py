bell(AlarmBell(on=True))
