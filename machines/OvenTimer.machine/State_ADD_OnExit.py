post_time(TimeLeft(True))
