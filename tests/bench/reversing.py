"""Go back through a recording that was run once, from a prompt, as a user waits for it."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from measure import Side
from table import WORST_S, Row

from llfsm.bridges.recording.reader import Recording
from llfsm.bridges.recording.recorders import record_script
from llfsm.cli.debug.prompt import AskedPrompt, ReversePrompt
from llfsm.cli.rerun import plan_of_one, reverse_debugging
from llfsm.runtime import Machine, Sensor, State
from llfsm.runtime.testing.scripted import Step
from llfsm.runtime.verification import Member
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int32

__all__ = ["rows"]

POSE = Slot("pose", Int32)
PERIOD_MS = 50
HOUR = 3600 * 1000 // PERIOD_MS
BACK = ["back turn", "back round", "back fire", "back leave", "reverse"]


class Bouncer(Machine):
    """Drive until something is near, then wait until it is not."""

    pose = Sensor(POSE, default=Int32())
    bounces: int = 0

    GO = State()
    STOP = State()
    GO.to(STOP, when=lambda m: m.pose.data > 9)
    STOP.to(GO, when=lambda m: m.pose.data <= 9)

    @GO.on_exit
    def _(self) -> None:
        self.bounces += 1


def rows(turns: int, places: int) -> Iterator[Row]:
    """Go back in so many turns, at places all over them, each reached by `goto`."""
    if sys.platform != "linux":
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.mcap"
        script = [Step(PERIOD_MS, {POSE: Int32(data=n * 7 % 12)}) for n in range(turns)]
        plan = {"machine": [{"definition": f"{__file__}:Bouncer"}]}
        record_script(file, [Member(Bouncer)], script, plan=plan, folder=Path(folder))
        recording = Recording(file)
        found = plan_of_one(recording, [f"{__file__}:Bouncer"], trust=False)
        with reverse_debugging(recording, *found, ReversePrompt) as client:
            prompt = AskedPrompt(client)
            first = _taken_ns(prompt, "goto 1e9")
            _taken_ns(prompt, "break Bouncer:STOP")
            samples = []
            for place in range(places, 0, -1):
                seconds = turns * PERIOD_MS / 1000 * place / places
                for line in (f"goto {seconds - 1}", *BACK):
                    samples.append(_taken_ns(prompt, line))
    what = f"a recording of {turns} turns, once"
    yield Row(what, [Side("llfsm", "goto 1e9", [first])], WORST_S, None)
    yield Row("  then each step back", [Side("llfsm", "back, goto, reverse", samples)], WORST_S, 2)


def _taken_ns(prompt: AskedPrompt, line: str) -> float:
    begun_ns = time.perf_counter_ns()
    assert [*prompt.do(line)]
    return time.perf_counter_ns() - begun_ns
