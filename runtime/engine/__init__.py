"""What gives machines their turns; nothing here imports anything else of the runtime."""
