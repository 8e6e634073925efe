pos_x = int(answer.x)
pos_y = int(answer.y)
