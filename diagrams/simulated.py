"""Simulated machines behind the ports of their stations: drives, a plant, currents, status."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiagramBuilder, InputPort, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, MatrixGain, PassThrough

from parapod.diagrams.disturbances import add_truth
from parapod.diagrams.ports import Behind, Port
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.pi_servo import PiServo
from parapod.systems.actuators.position_drive import PositionDrive
from parapod.systems.actuators.position_servo import PositionServo
from parapod.systems.actuators.velocity_servo import VelocityServo
from parapod.systems.core.errors import WiringError
from parapod.systems.sensors.device_status import DeviceStatus

# Values of measurements that stay as they are, by their names; 0 for those that are left out.
type Rest = Mapping[str, ArrayLike]


@dataclass(frozen=True)
class Plant[B]:
    """Bodies that drives move, or closed forms in their place.

    Attributes:
        signals: its ports by name.
        put: puts it at a beginning, in a root context.
        between_steps: see `Behind`.
        model: bodies and joints of a `MultibodyPlant`; None where none is simulated.
    """

    signals: Mapping[str, OutputPort]
    put: Callable[[Context, B], None]
    between_steps: Callable[[Context], None] | None = None
    model: Any = None


class Simulation[S, B]:
    """A simulated machine as its parts are added, each with its ports and its beginning.

    Attributes:
        builder: builder of the station.
        inputs: ports that take commands, by the station's names.
        outputs: ports that give measurements and truth, by the station's names.
        beginning: the beginning of the scenario that it is built from.
    """

    def __init__(self, builder: DiagramBuilder, begin: Callable[[S], B], scenario: S):
        """Adds nothing yet.

        Args:
            builder: builder of the station.
            begin: beginning of a scenario, in the quantities that the parts are set to.
            scenario: the scenario to build.
        """
        self.builder, self._begin = builder, begin
        self._puts: list[Callable[[Context, B], None]] = []
        self.beginning = begin(scenario)
        self.inputs: dict[str, InputPort] = {}
        self.outputs: dict[str, OutputPort] = {}
        self._plant: Plant[B] | None = None
        self._disturbances = getattr(scenario, "disturbances", ())

    @property
    def plant(self) -> Plant[B]:
        """The plant.

        Raises:
            WiringError: a mock, which has none.
        """
        if self._plant is None:
            raise WiringError("no plant stands behind the ports of a mock")
        return self._plant

    def add_drives[D: VelocityServo | PositionServo | PositionDrive | PiServo](
        self, drives: D, part: str, put: Callable[[D, Context, B], None] | None = None
    ) -> D:
        """Adds drives with `position_command` or `velocity_command`, `brake`, and encoders.

        Args:
            drives: the drives.
            part: part of the machine that they are of.
            put: puts them at a beginning, in a root context; None: they have one alone.
        """
        add(self.builder, drives, f"{part}_drives")
        for i in range(drives.num_input_ports()):
            port = drives.get_input_port(i)
            self.inputs[f"{part}.{port.get_name()}"] = port
        for name in ("position", "velocity"):
            self.outputs[f"{part}.{name}"] = drives.GetOutputPort(f"{name}_measured")
        if put is not None:
            self.on_put(lambda root_context, beginning: put(drives, root_context, beginning))
        return drives

    def add_plant(self, plant: Plant[B], hidden: Sequence[str] = ()) -> None:
        """Takes the plant, whose signals are the truth.

        Args:
            plant: the plant.
            hidden: signals that are for sensors alone.
        """
        self._plant = plant
        truth = {n: port for n, port in plant.signals.items() if n not in hidden}
        self.outputs |= {f"truth.{name}": port for name, port in truth.items()}
        self.on_put(plant.put)

    def add_current(self, part: str, force: OutputPort, force_per_current: float) -> None:
        """Adds currents of motors by the forces of their drives.

        Args:
            part: part of the machine.
            force: forces (n) [N].
            force_per_current: force by current [N/A].
        """
        count = force.size()
        per_newton = MatrixGain(np.eye(count) / force_per_current)
        current = add(self.builder, per_newton, f"{part}_current")
        connect(self.builder, force, current.get_input_port())
        self.outputs[f"{part}.current"] = current.get_output_port()

    def rest(self, ports: Iterable[Port], values: Rest) -> None:
        """Adds what is not there yet: commands without effect, measurements that stay.

        Args:
            ports: ports of the machine's table.
            values: values of these measurements.
        """
        for port in ports:
            if port.direction == "in" and port.name not in self.inputs:
                sink = add(self.builder, PassThrough(port.size), port.name)
                self.inputs[port.name] = sink.get_input_port()
            must_be = port.direction == "out" and port.default is None
            if must_be and port.name not in self.outputs:
                value = np.broadcast_to(np.asarray(values.get(port.name, 0.0), float), port.size)
                source = add(self.builder, ConstantVectorSource(value), port.name)
                self.outputs[port.name] = source.get_output_port()

    def on_put(self, put: Callable[[Context, B], None]) -> None:
        """Has something put at a beginning, in a root context, after what came before."""
        self._puts.append(put)

    def reset(self, root_context: Context, scenario: S) -> None:
        """Puts the machine at a beginning; what is built in stays.

        Args:
            root_context: context, at its defaults, of the diagram that contains the station.
            scenario: its beginning is taken.
        """
        beginning = self._begin(scenario)
        for put in self._puts:
            put(root_context, beginning)

    def behind(
        self, parts: Sequence[str], periods: Sequence[float] = (), delays: Sequence[float] = ()
    ) -> Behind:
        """The backend behind the ports; adds `status.*` and disturbances.

        Args:
            parts: the machine's parts.
            periods: periods of their samples [s]; empty: their data are never old.
            delays: further ages of their data [s]; empty: none.
        """
        periods = periods or (0.0,) * len(parts)
        status = add(self.builder, DeviceStatus(tuple(parts), periods, delays))
        for name in ("age", "fault"):
            self.outputs[f"status.{name}"] = status.GetOutputPort(name)
        self.outputs |= add_truth(self.builder, self._disturbances)
        between_steps = self._plant.between_steps if self._plant is not None else None
        return Behind(
            self.inputs, self.outputs, self.reset, between_steps=between_steps, handle=self
        )


# Adds drives that are at their commands, and what follows from them; the rest stays.
type Mirror[S] = Callable[[Simulation[S, S], S], Rest]


def add_mock[S](
    builder: DiagramBuilder,
    scenario: S,
    mirror: Mirror[S],
    ports: Iterable[Port],
    parts: Sequence[str],
) -> Behind:
    """Adds what mirrors commands to measurements, exactly and without dynamics.

    There are no `truth` ports: nothing is hidden. Its use: to try out a program around the ports
    where neither a plant's nor the hardware's peculiarities matter.

    Args:
        builder: builder of the station.
        scenario: the scenario to build.
        mirror: adds what moves; other commands have no effect, other measurements stay.
        ports: commands and measurements of the machine.
        parts: its parts.
    """
    mock = Simulation[S, S](builder, lambda scenario: scenario, scenario)
    mock.rest(ports, mirror(mock, scenario))
    return mock.behind(parts)
