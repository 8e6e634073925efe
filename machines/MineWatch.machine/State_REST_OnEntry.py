failure(PumpFailure(failed=False))
