if answer.number >= number and answer.failure:
    ask_position()  # like the original, which repeats its call
