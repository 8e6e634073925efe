suspend(target)
