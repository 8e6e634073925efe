permit(Permit(close=True))
