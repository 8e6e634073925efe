drug(Drug(Rate.BASAL))
