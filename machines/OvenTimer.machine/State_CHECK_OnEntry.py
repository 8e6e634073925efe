post_time(TimeLeft(minutes > 0))
