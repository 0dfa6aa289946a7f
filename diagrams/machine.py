"""What a machine is to the commands that know none: `parapod emulate`, `check`, `bench-rt`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.hardware_station import measured
from parapod.diagrams.ports import PortSpec
from parapod.diagrams.station import Station


@dataclass(frozen=True)
class Motion:
    """What a part is commanded and what of it is measured, for a self-test.

    Attributes:
        command: signal.
        unit: of the command.
        usual: command of a self-test for which nothing else is asked.
        largest: command that a self-test may give.
        measured: signal that is its integral.
        measured_unit: of that.
        gain: rate of the measured signal by command.
        rest: commands of the part besides, for which it moves.
    """

    command: str
    unit: str
    usual: float
    largest: float
    measured: str
    measured_unit: str
    gain: float
    rest: Mapping[str, float]


@dataclass(frozen=True)
class Machine[Scenario]:
    """One machine: its ports, and how its diagrams are made.

    Attributes:
        name: what people call it, with its article.
        experiment: with whose scenario it is emulated and tested unless another one is named.
        scenario: the schema, with `backend`, `seed`, `control.period`, `plant.time_step` and
            `hardware`.
        simulated: its backends with a plant, and how often they and emulated devices can see
            each other in real time [s].
        inputs: of its station.
        outputs: of every station of it.
        truth: outputs besides of a simulated one.
        idle: values of inputs that nobody drives; 0 for those that are left out.
        signals: units of the controller's outputs and of whatever else is recorded, by name.
        motions: how a part may be moved by a self-test, by its name.
        make_station: builds the station of a scenario.
        make_closed_loop: builds the closed loop of a scenario, which records nothing.
        behind_devices: the scenario of the station that is simulated behind emulated devices,
            with that period [s] of the exchange between them; what the devices do themselves,
            the station does not.
    """

    name: str
    experiment: str
    scenario: type[Scenario]
    simulated: Mapping[str, float]
    inputs: tuple[PortSpec, ...]
    outputs: tuple[PortSpec, ...]
    truth: tuple[PortSpec, ...]
    idle: Mapping[str, float]
    signals: Mapping[str, str]
    motions: Mapping[str, Motion]
    make_station: Callable[[Scenario], Station[Scenario]]
    make_closed_loop: Callable[[Scenario], ClosedLoop[Scenario]]
    behind_devices: Callable[[Scenario, float], Scenario]

    @property
    def measured(self) -> tuple[PortSpec, ...]:
        """What its devices measure."""
        return measured(self.outputs)

    def has(self, scenario: Any) -> bool:
        """Whether a scenario is one of this machine."""
        return isinstance(scenario, self.scenario)

    @cached_property
    def units(self) -> dict[str, str]:
        """Units of all its signals, by name."""
        ports = {spec.name: spec.unit for spec in (*self.inputs, *self.outputs, *self.truth)}
        return ports | dict(self.signals)
