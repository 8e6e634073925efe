#include <iostream>
#include "CLMacros.h"
