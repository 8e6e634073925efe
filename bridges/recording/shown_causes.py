"""Why machines of a recording are in their states, as the messages that a page shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from llfsm.whiteboard import Message, Sample
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.messages.debugging import MachineWhy, why_slot
from llfsm.whiteboard.messages.llfsm import MACHINES, MachineStatus
from llfsm.whiteboard.slots import legal_name

from .reader import RecordedJournal, Recording
from .recorded_causes import causes_at

if TYPE_CHECKING:
    from .explaining import Explainer

__all__ = ["ShownCauses"]


class ShownCauses:
    """Make a sample for each live machine of which there are events."""

    def __init__(self, recording: Recording, explainer: Explainer | None):
        self._recording = recording
        self._explainer = explainer
        self._shown: dict[str, Sample[Message]] = {}
        statuses = {n for n, each in recording.slots.items() if each.slot.type is MachineStatus}
        whys = [why_slot(name.removeprefix(MACHINES)) for name in statuses]
        self.slots = {
            each.name: SlotInfo(each.name, each.type_name, each.schema, each.capacity)
            for each in (whys if recording.journals else ())
        }
        """Those of the samples."""

    def at(
        self,
        now_ns: int,
        samples: Mapping[str, Sample[Message]],
        is_live: Callable[[Sample[Any]], bool],
    ) -> dict[str, Sample[Message]]:
        """Return the samples for a moment; `samples` has the machines' statuses then."""
        living = {
            name.removeprefix(MACHINES): sample.message.pid
            for name, sample in samples.items()
            if isinstance(sample.message, MachineStatus) and is_live(sample)
        }
        found: dict[str, Sample[Message]] = {}
        for journal in self._recording.journals:
            if journal.process in living.values():
                for machine, why in self._causes(journal, now_ns):
                    legal = legal_name(machine)
                    for name, process in living.items():
                        is_numbered = name.startswith(f"{legal}.")  # its name was taken
                        if process == journal.process and (name == legal or is_numbered):
                            found[why_slot(name).name] = self._sample(name, why, now_ns)
        return found

    def close(self) -> None:
        """End the explainer."""
        if self._explainer is not None:
            self._explainer.close()

    def _causes(self, journal: RecordedJournal, now_ns: int) -> Iterator[tuple[str, MachineWhy]]:
        found, problem = causes_at(self._recording, journal, now_ns), ""
        if self._explainer is not None and self._explainer.process == journal.process:
            found |= self._explainer.at(now_ns)
            problem = self._explainer.problem
        for machine, why in found.items():
            yield machine, replace(why, problem=problem)

    def _sample(self, name: str, why: MachineWhy, now_ns: int) -> Sample[Message]:
        before = self._shown.get(name)
        if before is not None and before.message == why:
            return before
        count = 1 if before is None else before.count + 1
        sample: Sample[Message] = Sample(why, count, now_ns, 0)
        self._shown[name] = sample
        return sample
