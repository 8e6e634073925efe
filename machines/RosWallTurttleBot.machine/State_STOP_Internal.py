if answer.number >= number and answer.failure:
    ask_position()  # as the original, which calls until it is told
