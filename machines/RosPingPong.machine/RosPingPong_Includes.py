"""Post and log ``hello world <count>``, counting up, every 20 ms after the first second."""

import logging

from llfsm.runtime import Actuator
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import String

log = logging.getLogger(__name__)
