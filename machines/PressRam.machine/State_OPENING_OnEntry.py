ram(Ram(Way.UP))
