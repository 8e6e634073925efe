drug(Drug(Rate.NONE))
