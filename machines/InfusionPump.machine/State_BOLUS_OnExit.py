drug(Drug(Rate.BASAL))
stop_at_fault()
