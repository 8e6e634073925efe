minutes += 1
