failure(PumpFailure(failed=True))
