"""A machine that posts a text repeatedly."""

import logging

from llfsm.machines.common import stopping
from llfsm.runtime import Actuator, Machine, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import String

__all__ = ["PINPONG", "RosPingPong"]

PINPONG = Slot("pinpong", String)
_log = logging.getLogger(__name__)


class RosPingPong(Machine):
    """After one second, post and log ``hello world <count>`` every 20 ms, counting up."""

    publish = Actuator(PINPONG)
    count: int = 0

    INITIAL = State()
    PUBLISH = State()
    WAIT_AND_COUNT = State()
    END = State()

    @INITIAL.on_entry
    def _(self) -> None:
        self.count = 0

    @PUBLISH.on_entry
    def _(self) -> None:
        text = f"hello world {self.count}"
        _log.info(text)
        self.publish(String(text))

    @WAIT_AND_COUNT.on_entry
    def _(self) -> None:
        self.count += 1

    INITIAL.to(PUBLISH, after_ms=1000)
    PUBLISH.to(WAIT_AND_COUNT, after_ms=10)
    WAIT_AND_COUNT.to(PUBLISH, after_ms=10)

    INITIAL.to(END, when=stopping)
    PUBLISH.to(END, when=stopping)
    WAIT_AND_COUNT.to(END, when=stopping)
