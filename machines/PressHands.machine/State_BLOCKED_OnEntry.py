permit(Permit(close=False))
