count = 0;
lamp(false);
