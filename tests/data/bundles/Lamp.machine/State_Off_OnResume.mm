lamp(false);
