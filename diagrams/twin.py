"""Drawing of a machine by its signals alone, outside of any simulation."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import PassThrough

from parapod.diagrams.wiring import add
from parapod.systems.core.errors import WiringError

MEASURED, DESIRED = "measured", "desired"
PALE = 0.25  # opacity of what is only asked for

# Takes times (k) [s] and samples (k, ...) of signals, piece by piece in the order of time, and
# returns samples (k, ...) of further ones.
type Tracker = Callable[
    [NDArray[np.float64], Mapping[str, NDArray[Any]]], Mapping[str, NDArray[np.float64]]
]


class Twin:
    """Drawing of a machine as its signals show it, beside one of what it is asked for.

    A machine's own class adds both to `builder` under the paths `path(MEASURED)` and
    `path(DESIRED)`, with `input` for what they follow, calls `finish`, and defines `show`, which
    ends with `_publish`.

    Attributes:
        signals: names of the signals that it is drawn by; a loop need not have all of them.
        needed: those of them without which nothing can be drawn.
        stand_ins: signals that take the place of others in a recording that lacks these.
        tracked: further signals, which follow from all samples before; see `tracker`.
        meshcat: the scene; None: only the bodies' poses are computed, see `scene_graphs`.
        builder: builder of its diagram, until `finish`.
        time: time of the newest drawing [s].
    """

    signals: ClassVar[frozenset[str]]
    needed: ClassVar[frozenset[str]]
    stand_ins: ClassVar[Mapping[str, str]] = {}
    tracked: ClassVar[frozenset[str]] = frozenset()

    @classmethod
    def tracker(cls, scenario: Any) -> Tracker | None:
        """Makes what has to see every sample of a recording, of which few are drawn.

        A machine whose place follows from its steps defines it: `show` is then given the signals
        `tracked` beside those of the recording, and has to do with every sample where it is not.

        Args:
            scenario: scenario of the machine.

        Returns:
            A function of the samples of those of `signals` that there are; None: each sample
            tells all by itself.
        """
        return None

    def __init__(self, meshcat: Meshcat | None, scenario: Any, prefix: str = ""):
        """Draws nothing yet.

        Args:
            meshcat: the scene, or None.
            scenario: scenario of the machine.
            prefix: prefix of its paths there, where it is a guest in another machine's scene and
                has surroundings already.
        """
        self.meshcat, self._prefix = meshcat, prefix
        self.builder, self.time = DiagramBuilder(), 0.0
        self._diagram: Diagram
        self._context: Context

    def path(self, drawing: str) -> str:
        """Path of one of its drawings in the scene."""
        return self._prefix + drawing

    @property
    def is_guest(self) -> bool:
        """Whether it is drawn in the scene of another machine."""
        return bool(self._prefix)

    def input(self, name: str, size: int) -> OutputPort:
        """Adds what a drawing follows; `_publish` is given it by this name."""
        through = add(self.builder, PassThrough(size), f"shown_{name}")
        self.builder.ExportInput(through.get_input_port(), name)
        return through.get_output_port()

    def finish(self) -> None:
        """Builds the diagram."""
        self._diagram = self.builder.Build()
        self._context = self._diagram.CreateDefaultContext()

    def show(self, values: Mapping[str, NDArray[Any]], time: float = 0.0) -> None:
        """Draws the newest values, of those of the signals that there are.

        Values of which too little is known, or not finite, leave the last picture.

        Args:
            values: values by signal.
            time: time in a recording of the scene [s].

        Raises:
            WiringError: values of another machine, or of another scenario.
        """
        raise NotImplementedError(f"{type(self).__name__} does not define show")

    def knows(self, values: Mapping[str, NDArray[Any]]) -> bool:
        """Whether all that it needs is finite."""
        return all(np.isfinite(values[name]).all() for name in self.needed)

    def _publish(self, values: Mapping[str, ArrayLike], time: float) -> None:
        """Draws what the inputs have."""
        self.time = time
        self._context.SetTime(time)
        for name, value in values.items():
            self._fix(name, value)
        self._diagram.ForcedPublish(self._context)
        if self.meshcat is not None:
            self.meshcat.SetProperty(self.path(DESIRED), "modulated_opacity", PALE)

    def _fix(self, name: str, value: ArrayLike) -> None:
        """Lets a drawing follow a value.

        Raises:
            WiringError: a signal of another machine, or of another scenario.
        """
        port, array = self._diagram.GetInputPort(name), np.asarray(value, dtype=float)
        if array.shape != (port.size(),):
            raise WiringError(
                f"{name} of the drawing has {port.size()} elements, the signal {array.size}"
            )
        port.FixValue(self._context, array)

    def scene_graphs(self) -> dict[str, tuple[SceneGraph, Context]]:
        """The scene graph of each drawing, with its context as it was shown last."""
        scene_graphs = {}
        for drawing in (MEASURED, DESIRED):
            graph: Any = self._diagram.GetSubsystemByName(f"drawing_of_{self.path(drawing)}")
            scene_graphs[drawing] = (graph, graph.GetMyContextFromRoot(self._context))
        return scene_graphs
