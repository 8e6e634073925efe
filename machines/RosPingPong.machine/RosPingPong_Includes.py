"""After one second, post and log ``hello world <count>`` every 20 ms, counting up."""

import logging

from llfsm.runtime import Actuator
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import String

log = logging.getLogger(__name__)
