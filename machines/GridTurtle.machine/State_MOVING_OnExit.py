linear, angular = command.linear.x, command.angular.z
if angular:
    eighths = 2 if grip.firm else 1
    heading = (heading + (eighths if angular > 0 else -eighths)) % 8
if linear:
    way = 1 if linear > 0 else -1
    ahead = AHEAD[heading]
    x = min(max(x + way * ahead[0], 0), FIELD)
    y = min(max(y + way * ahead[1], 0), FIELD)
if linear or angular:
    forget(TurtlePositionRequest())
    answer(TurtlePositionAnswer())
elif request.number:
    answer(TurtlePositionAnswer(request.number, float(x), float(y)))
