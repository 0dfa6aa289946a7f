"""Drawing of a machine from the samples of a log."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat

from parapod.diagrams.machine import Machine
from parapod.diagrams.twin import Tracker, Twin
from parapod.systems.core.errors import ParapodError

type Floats = NDArray[Any]


@dataclass(frozen=True)
class LogDrawing:
    """Drawing of a log that is not of a closed loop, and its usual plots.

    Attributes:
        machine: the machine of which the log shows something; it is drawn in the scenario that
            the experiment's `machine_scenario` makes.
        stand_ins: signals in the log that take the place of others, by signal of the drawing.
        twin: drawing of a part of the machine; None: the machine's own.
        plots: usual plots, as a machine declares them; none: the machine's.
    """

    machine: Machine[Any]
    stand_ins: Mapping[str, str] = field(default_factory=dict)
    twin: type[Twin] | None = None
    plots: Sequence[str] = ()


@dataclass(frozen=True)
class DrawnLog:
    """Machine of a log, and the signals that show its motion.

    Attributes:
        twin: drawing of the machine, or of the part of it that the log records.
        scenario: the machine's.
        sources: signals in the log that the drawing follows, by signal of the drawing.
    """

    twin: type[Twin]
    scenario: Any
    sources: Mapping[str, str]

    @classmethod
    def from_shapes(
        cls,
        machine: Machine[Any],
        scenario: Any,
        drawing: LogDrawing | None,
        shapes: Mapping[str, tuple[int, ...]],
    ) -> Self:
        """Finds out which signals show the motion of a machine.

        Args:
            machine: the machine as the scenario has it.
            scenario: the machine's.
            drawing: drawing that the experiment declares, or None.
            shapes: shape of one sample of each signal of the log, by name.

        Raises:
            ParapodError: the machine has no drawing, or the log does not show its motion.
        """
        twin = (drawing and drawing.twin) or machine.view.twin
        if twin is None:
            raise ParapodError(f"{machine.title} has no drawing")
        stand_ins = {**twin.stand_ins, **({} if drawing is None else drawing.stand_ins)}
        signal_names = {
            n: n if n in shapes else stand_ins.get(n, "") for n in sorted(twin.signals)
        }
        sources = {name: source for name, source in signal_names.items() if source in shapes}
        missing = twin.needed - sources.keys()
        if missing:
            raise ParapodError(f"the log has no {', '.join(sorted(missing))}")
        for name in sorted(set(sources.values()) & set(machine.table)):
            size, declared = int(np.prod(shapes[name])), machine.table[name].size
            if declared and size != declared:
                raise ParapodError(f"its {name} has {size} elements, {machine.title}'s {declared}")
        return cls(twin, scenario, sources)

    def make(self, meshcat: Meshcat | None = None, prefix: str = "") -> Any:
        """The drawing; see `Twin`."""
        return self.twin(meshcat, self.scenario, prefix)

    def values(self, row: Mapping[str, Floats]) -> dict[str, Floats]:
        """Samples of the log, and what is tracked, by the names that the drawing has for them."""
        samples = {name: row[source] for name, source in self.sources.items()}
        return samples | {name: row[name] for name in self.twin.tracked & row.keys()}

    def tracker(self) -> Tracker | None:
        """Tracker of the drawing, which takes the log's samples by their names; or None."""
        track = self.twin.tracker(self.scenario)
        if track is None:
            return None
        return lambda time, samples: track(time, self.values(samples))
