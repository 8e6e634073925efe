ram(Ram(Way.DOWN))
