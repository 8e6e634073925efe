minutes -= 1
