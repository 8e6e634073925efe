stop_at_fault()
