ram(Ram(Way.REST))
