"""Why machines of a recording are in their states, and their variables, as messages for a page.

A journal has the value of each guard that was evaluated. With what the guard saw, there is more to
be known: :mod:`.explaining` runs the machines again for that.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from llfsm.whiteboard import Message, Sample, Slot
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.messages.debugging import MachineWhy, SeenTransition, why_slot
from llfsm.whiteboard.messages.llfsm import MACHINES, MachineStatus, variables_slot
from llfsm.whiteboard.slots import legal_name

from .errors import RecordingFileError
from .reader import RecordedJournal, Recording

if TYPE_CHECKING:
    from .explaining import Explainer

__all__ = ["ShownCauses", "causes_at"]

_KIND_BYTES: Final = 24  # at the beginning of an entry, which contain its kind
_MOST: Final = 10_000  # entries that are looked at


class ShownCauses:
    """Make a sample for each live machine of which there are events."""

    def __init__(self, recording: Recording, explainer: Explainer | None):
        self._recording = recording
        self._explainer = explainer
        self._shown: dict[str, Sample[Message]] = {}
        statuses = [n for n, each in recording.slots.items() if each.slot.type is MachineStatus]
        names = [name.removeprefix(MACHINES) for name in statuses if recording.journals]
        slots: list[Slot[Any]] = [*map(why_slot, names)]
        if explainer is not None:
            known = [variables_slot(name) for name in names]
            slots += [each for each in known if each.name not in recording.slots]
        self.slots = {
            each.name: SlotInfo(each.name, each.type_name, each.schema, each.capacity)
            for each in slots
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
                for machine, messages in self._known(journal, now_ns).items():
                    legal = legal_name(machine)
                    for name, process in living.items():
                        is_numbered = name.startswith(f"{legal}.")  # its name was taken
                        if process == journal.process and (name == legal or is_numbered):
                            for message in messages:
                                slot = _slot_of(message, name)
                                found[slot] = self._sample(slot, message, now_ns)
        return found

    def close(self) -> None:
        """End the explainer."""
        if self._explainer is not None:
            self._explainer.close()

    def _known(self, journal: RecordedJournal, now_ns: int) -> dict[str, tuple[Message, ...]]:
        """Return the messages of each machine of a journal, by its name there."""
        causes, problem = causes_at(self._recording, journal, now_ns), ""
        found: dict[str, tuple[Message, ...]] = {}
        if self._explainer is not None and self._explainer.process == journal.process:
            found = {**self._explainer.at(now_ns)}
            problem = self._explainer.problem
        rest = {name: (replace(why, problem=problem),) for name, why in causes.items()}
        return rest | found

    def _sample(self, slot: str, message: Message, now_ns: int) -> Sample[Message]:
        before = self._shown.get(slot)
        if before is not None and before.message == message:
            return before
        count = 1 if before is None else before.count + 1
        sample: Sample[Message] = Sample(message, count, now_ns, 0)
        self._shown[slot] = sample
        return sample


def _slot_of(message: Message, machine: str) -> str:
    is_why = isinstance(message, MachineWhy)
    return (why_slot(machine) if is_why else variables_slot(machine)).name


def causes_at(recording: Recording, journal: RecordedJournal, now_ns: int) -> dict[str, MachineWhy]:
    """Return why each machine of a journal is where it is, by its last turn before that moment."""
    evaluated: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)  # the last one first
    found: dict[str, MachineWhy] = {}
    rounds = 0
    for number, record in enumerate(recording.backwards(journal, now_ns)):
        kind = record.data[:_KIND_BYTES]
        rounds += b'"RoundBegin"' in kind
        if rounds > 1 or number == _MOST:  # each machine has had its turn in a whole round
            break
        if b'"Eval"' not in kind and b'"Turn"' not in kind:
            continue
        with suppress(RecordingFileError):
            entry = recording.entry(record)
            machine = entry["machine"]
            if machine in found:
                continue
            if entry["event"] == "Eval":
                evaluated[machine].append(entry)
            else:
                evaluated_s = (now_ns - recording.time_of(record)) / 1e9
                found[machine] = _why(entry["state"], evaluated[machine][::-1], evaluated_s)
    return found


def _why(state: str, evaluated: list[dict[str, Any]], evaluated_s: float) -> MachineWhy:
    seen = tuple(
        SeenTransition(each["target"], each["label"], each["value"], each["label"])
        for each in evaluated
    )
    if seen and seen[-1].value is True:
        return MachineWhy(seen[-1].target, (), state, seen)
    return MachineWhy(state, seen, evaluated_s=evaluated_s if seen else None)
