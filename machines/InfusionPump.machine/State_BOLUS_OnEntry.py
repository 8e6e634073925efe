drug(Drug(Rate.BOLUS))
