"""`llfsm run --ros --lifecycle`: a process that others configure and activate."""

from __future__ import annotations

import signal
from pathlib import Path

from llfsm.bridges.ros2.qos import Qos
from waiting import PATIENCE_S

LAMP = """
from llfsm.runtime import Actuator, Machine, State
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool

class Lamp(Machine):
    lamp = Actuator(Slot("lamp", Bool), at_suspend=Bool(False))
    on = State()

    dark = State()

    @on.internal
    def _(self) -> None:
        self.lamp(Bool(True))

    on.to(dark, when=lambda self: self.stopping)
"""


def change(peer, types, label):
    of = types.service("lifecycle_msgs/srv/ChangeState")
    transition = types.message("lifecycle_msgs/msg/Transition").message(label=label)
    with peer.node("manager").client("/lamp/change_state", of) as client:
        assert peer.wait_graph(lambda _: client.ready, PATIENCE_S)
        request = of.request.message(transition=transition)
        return client.call(request, timeout=PATIENCE_S).result().success


def test_a_run_that_others_control(run, domain, router, peer, types, seen, tmp_path: Path):
    file = tmp_path / "lamp.py"
    file.write_text(LAMP)
    bool_, lamp = types.message("std_msgs/msg/Bool"), seen()
    peer.node("eye").subscription("lamp", bool_, lambda a: lamp(a.decode().data), Qos(depth=9))
    at = ["--transport", "zenoh", "--router", router, "--domain", str(domain)]
    process = run("run", "--ros", "--lifecycle", f"{file}:Lamp", "--node", "lamp", *at)
    process.says("as /lamp")
    assert change(peer, types, "configure")
    assert not lamp
    assert change(peer, types, "activate")
    lamp.wait(lambda lamp: lamp[-1:] == [True])
    assert change(peer, types, "deactivate")
    lamp.wait(lambda lamp: lamp[-1:] == [False])
    assert change(peer, types, "activate")
    lamp.wait(lambda lamp: lamp[-1:] == [True])
    process.process.send_signal(signal.SIGINT)
    assert process.end(signal.SIGINT) == 0
