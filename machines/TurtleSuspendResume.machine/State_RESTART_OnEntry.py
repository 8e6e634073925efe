resume(target)
