"""Declaration of a machine: one table of ports, from which its diagrams follow by name.

Controller and station call a signal by the same name (`legs.extension`, `imu.gyro`). Export,
wiring, idling, logging, faults, mock and hardware therefore need only the table, and are written
once, in this folder. A machine is found by its name among the entry points `parapod.machines`.
"""

import json
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder, System

from parapod.diagrams.disturbances import ON_BODIES, SHOWN, Acting, check_disturbances, ports_of
from parapod.diagrams.faults import FaultTarget, targets_of
from parapod.diagrams.own_controller import OWN, check_period, own_name, own_system
from parapod.diagrams.plots import Limits
from parapod.diagrams.ports import Behind, Inner, Out, Port
from parapod.diagrams.real import MachineView, RealMachine
from parapod.diagrams.simulated import Mirror, add_mock
from parapod.diagrams.wiring import inputs_of, outputs_of
from parapod.systems.core.errors import ParapodError, ScenarioError, WiringError
from parapod.systems.core.installed import current_name, installed
from parapod.systems.core.schema import Schema, plain, quantity
from parapod.systems.hardware.buses.address import is_address

if TYPE_CHECKING:
    from parapod.diagrams.drivers.driver import Driver

_STATUS = ("status.age", "status.fault")


@dataclass
class ControlScenario(Schema):
    """The controller.

    Attributes:
        period: sampling period of the controller [s].
        controller: function that makes a controller of one's own, as "my_file.py:make" or
            "package.module:function"; empty: the machine's.
    """

    period: float = quantity(0.01, 0.001, 0.1)
    controller: str = ""


@dataclass
class MachineScenario(Schema):
    """One run of a machine; a base for machines' own scenarios, which need not use it.

    Attributes:
        backend: plant behind the station's ports.
        seed: seed of everything random.
        control: see `ControlScenario`.
    """

    backend: str = "kinematic"
    seed: int = quantity(0, 0, 2**31 - 1)
    control: ControlScenario = field(default_factory=ControlScenario)


# Rows of NumPy's: arrays of more leave the caches. MuJoCo takes as long for each, however many.
_OVER_ROWS = {"kinematic": 1000, "mujoco": 100}

type Plant[S] = Callable[[DiagramBuilder, S, Meshcat | None], Behind]


@dataclass(frozen=True, repr=False)
class Machine[S]:
    """One machine: its ports, and how the parts of its diagrams are made.

    A scenario of a machine has `backend`, `seed` and `control.period`; `faults` where faults are
    injected; `hardware.drivers` for the backend "hardware", see `drivers`.

    Attributes:
        name: the name of its entry point.
        title: its name in sentences, with the article.
        scenario: schema of its scenarios.
        ports: table of its signals; `status.*` are added.
        axes: names of the axes of a part for people, such as ("leg 1", "leg 2"), by part; they
            name the elements of its ports of that size.
        parts: parts whose devices `status.age` and `status.fault` report, in that order.
        plants: simulated backends by name; each adds a plant and returns it as `Behind`.
        mirror: adds drives that are at their commands to the backend "mock", whose other ports
            follow from the table; returns values of measurements that stay.
        controller: makes its own controller of a scenario; see `controller_of`.
        sources: makes the systems that command the controller and the machine beside it.
        experiment: experiment whose scenario is used where only the machine is named.
        real: parts of a real one beside its drivers, and settings of its emulation.
        view: drawing and plots by which it is looked at.
        limits: makes, of a scenario, the smallest and the largest admissible value of signals in
            their units, beside those that ports declare: a number for all elements, or one for
            each; None: there is none.
        resets: dotted keys of a scenario, or of whole parts of one, that `reset` of its loop takes
            over from another scenario; nothing that differs in these alone is built again.
        disturbances: kinds of disturbances that act on it, by simulated backends; a scenario
            without the key `disturbances` has none.
        feet: number of feet under which ground may give way; 0 for a machine without.
        over_rows: backends whose plants have laws over rows, with the number of runs that are
            simulated together unless another one is asked for: more are no faster.
        variant: attributes that depend on the scenario, by their names; what is declared here is
            then that of the default scenario. Names and units of ports are always the same.

    A station also has the ports of its scenario's disturbances, see `disturbances.ports_of`.
    """

    name: str
    title: str
    scenario: type[S]
    ports: tuple[Port, ...]
    parts: tuple[str, ...]
    plants: Mapping[str, Plant[S]]
    controller: Callable[[S], System]
    mirror: Mirror[S] = lambda mock, scenario: {}
    axes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    sources: Callable[[S], Sequence[System]] = lambda scenario: ()
    experiment: str = ""
    real: RealMachine[S] = field(default_factory=RealMachine)
    view: MachineView = field(default_factory=MachineView)
    limits: Callable[[S], Limits] = lambda scenario: {}
    resets: Callable[[S], tuple[str, ...]] = lambda scenario: ()
    disturbances: Acting = field(default_factory=lambda: ON_BODIES)
    feet: int = 0
    over_rows: Mapping[str, int] = field(default_factory=lambda: dict(_OVER_ROWS))
    variant: Callable[[S], Mapping[str, Any]] | None = None

    def for_scenario(self, scenario: S) -> "Machine[S]":
        """The machine as a scenario has it.

        Raises:
            ScenarioError: disturbances that do not act on it.
        """
        settings: Any = scenario
        machine = self
        if self.variant is not None:
            machine = replace(self, **self.variant(scenario), variant=None)
        disturbances = getattr(scenario, "disturbances", ())
        check_disturbances(disturbances, settings.backend, machine.disturbances, machine.feet)
        more = [p for p in ports_of(disturbances, machine.feet) if p.name not in machine.table]
        return replace(machine, ports=(*machine.ports, *more)) if more else machine

    def of(self, scenario: S) -> "Machine[S]":
        """Former name of `for_scenario`."""
        warnings.warn("Machine.of is now Machine.for_scenario", DeprecationWarning, stacklevel=2)
        return self.for_scenario(scenario)

    def structure(self, scenario: S) -> str:
        """The built-in part of a scenario, as a text: one loop serves all that share it."""
        settings: Any = scenario
        tree = plain(scenario)
        # A controller of one's own may be built from anything.
        is_reset = settings.backend in self.plants and not own_name(scenario)
        for key in self.resets(scenario) if is_reset else ():
            *parts, last = key.split(".")
            node = tree
            for part in parts:
                node = node[part]
            del node[last]
        return json.dumps(tree, default=repr)

    def controller_of(
        self,
        scenario: S,
        usual: Callable[[S], System] | None = None,
        sources: Sequence[System] = (),
    ) -> System:
        """The controller of a scenario: the one that `control.controller` names, or the usual one.

        A function that is named there is called with the scenario and this machine. Its system
        has those outputs of the usual controller that the station or a source takes, and any
        other ports.

        Args:
            scenario: one of its scenarios.
            usual: makes the usual controller; None: `controller`.
            sources: sources of commands beside it.

        Raises:
            ScenarioError: `control.controller` makes no system that can replace the usual one.
        """
        settings: Any = scenario
        usual, name = usual or self.controller, own_name(scenario)
        if not name:
            return usual(scenario)
        if is_address(name):
            from parapod.diagrams.bus_controller import PATIENCE, bus_controller

            own, period = usual(self.scenario()), settings.control.period
            # The loop of a real machine never waits: old commands leave it neutral in time.
            patience = 0.0 if settings.backend == "hardware" else PATIENCE
            address = settings.hardware.address(name, OWN)
            return bus_controller(self, period, address, own, sources, patience)
        read = {port.name for port in self.inputs}.union(*map(inputs_of, sources))
        # Of the default scenario: limits of its settings are not those of another controller.
        outputs = [output for output in outputs_of(usual(self.scenario())) if output in read]
        system = own_system(OWN, name, scenario, self, outputs=outputs)
        check_period(OWN, name, system, settings.control.period)
        system.set_name("controller")
        return system

    def with_signals(self, signals: Iterable[str]) -> "Machine[S]":
        """The machine with further signals of a controller, whose units are not declared."""
        more = [
            Inner(name, "-", "signal of one's own") for name in signals if name not in self.table
        ]
        return replace(self, ports=(*self.ports, *more)) if more else self

    def all_limits(self, scenario: S) -> Limits:
        """Limits that its ports declare, and those of a scenario."""
        return {**self.limits_of_ports, **self.limits(scenario)}

    @property
    def limits_of_ports(self) -> Limits:
        """Limits that its ports declare, which hold in every scenario."""
        return {n: port.limits for n, port in self.table.items() if port.limits is not None}

    def __repr__(self) -> str:
        return f"<machine {self.name}: {len(self.inputs)} inputs, {len(self.outputs)} outputs>"

    @cached_property
    def table(self) -> dict[str, Port]:
        """All signals by name, `status.*` included.

        Raises:
            WiringError: a name that stands in the table twice.
        """
        of = ", ".join(self.parts)
        size = len(self.parts)
        status = (
            Out("status.age", size, "s", f"age of the data of {of}", default=0.0),
            Out("status.fault", size, "code", f"a `DeviceFault` of {of}; 0 none", default=0.0),
        )
        table: dict[str, Port] = {}
        for port in (*self.ports, *status):
            if port.name in table:
                raise WiringError(f"{self.title} declares the port '{port.name}' twice")
            table[port.name] = port
        return table

    def directed(self, *directions: str) -> tuple[Port, ...]:
        """The ports of these directions."""
        return tuple(port for port in self.table.values() if port.direction in directions)

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs of the station."""
        return self.directed("in")

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Outputs of every station."""
        return self.directed("out")

    @property
    def measured(self) -> tuple[Port, ...]:
        """Outputs measured by a device: all but `status.*`."""
        return tuple(port for port in self.outputs if port.name not in _STATUS)

    @property
    def truth(self) -> tuple[Port, ...]:
        """Further outputs of a simulated station."""
        return self.directed("truth")

    @cached_property
    def targets(self) -> dict[str, FaultTarget]:
        """Signals into which faults may be injected, by the names that scenarios give them."""
        return targets_of(tuple(self.table.values()))

    @property
    def plots(self) -> tuple[str, ...]:
        """Usual plots of a recording, those of its view and what disturbed it."""
        return (*self.view.plots, *SHOWN)

    @property
    def backends(self) -> tuple[str, ...]:
        """Backends of its station."""
        more: tuple[str, ...] = ("mock",)
        if hasattr(self.scenario, "hardware") or "hardware" in _fields(self.scenario):
            more = (*more, "hardware")
        return (*self.plants, *more)

    def behind(self, builder: DiagramBuilder, scenario: S, meshcat: Meshcat | None) -> Behind:
        """Adds the backend of a scenario.

        Args:
            builder: builder of the station.
            scenario: its `backend` decides; devices are those of `drivers`.
            meshcat: draws a simulated machine there; None for no drawing.

        Raises:
            ScenarioError: unknown backend, or drivers that do not make this machine.
        """
        settings: Any = scenario
        backend = settings.backend
        if backend not in self.backends:
            backends = ", ".join(self.backends)
            raise ScenarioError(f"backend {backend!r} is not one of {backends}", "backend")
        if backend in self.plants:
            return self.plants[backend](builder, scenario, meshcat)
        if backend == "mock":
            ports = (*self.inputs, *self.measured)
            return add_mock(builder, scenario, self.mirror, ports, self.parts)
        from parapod.diagrams.devices import add_devices

        period = settings.control.period
        drivers = self.drivers(scenario)
        return add_devices(builder, drivers, self.inputs, self.measured, self.parts, period)

    def drivers(self, scenario: S) -> "list[Driver]":
        """Drivers of a scenario's `hardware.drivers`, with what follows from its machine."""
        settings: Any = scenario
        fittings = self.for_scenario(scenario).real.fittings
        return [one.fitted(fittings.get(one.part, {})) for one in settings.hardware.connected]

    def unit(self, name: str) -> str:
        """Unit of a signal, by the name of its port.

        Raises:
            KeyError: a signal that the machine does not declare.
        """
        if name.startswith("fault."):
            return "s" if name.endswith(".extra_age") else "0/1"
        return self.table[name].unit

    def element_name(self, name: str, element: int) -> str:
        """Name of an element of a signal for people; "" where there is none."""
        if name not in self.table:
            return ""
        port = self.table[name]
        axes = self.axes.get(port.part, ())
        if axes and not port.elements and port.size == len(axes):
            return axes[element]
        return port.element_name(element)


def numbered(word: str, count: int) -> tuple[str, ...]:
    """Names of the axes of a part: `word` with 1, 2, ..."""
    return tuple(f"{word} {i}" for i in range(1, count + 1))


def find_machine(name: str) -> Machine[Any]:
    """The machine of a name; loads no other one.

    Raises:
        ParapodError: there is none of this name, or its package cannot be loaded.
    """
    group = "parapod.machines"
    name, points = current_name(group, name), installed(group)
    matches = [entry for entry in points if entry.name == name]
    if not matches:
        names = ", ".join(sorted({entry.name for entry in points}))
        raise ParapodError(f"there is no machine '{name}'; there are: {names}")
    (entry, *_) = matches
    try:
        machine: Machine[Any] = entry.load()
    except Exception as error:
        package = entry.dist.name if entry.dist is not None else entry.module
        raise ParapodError(
            f"the machine '{name}' of the package '{package}' cannot be loaded: "
            f"{type(error).__name__}: {error}"
        ) from error
    return machine


def list_machines() -> tuple[Machine[Any], ...]:
    """All machines that are installed; loads them."""
    names = sorted({entry.name for entry in installed("parapod.machines")})
    return tuple(find_machine(name) for name in names)


def _fields(schema: type) -> Mapping[str, Any]:
    return getattr(schema, "__dataclass_fields__", {})
