"""Station, controller and sources of commands in one diagram, connected by port name."""

from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    EventStatus,
    OutputPort,
    System,
)
from pydrake.systems.primitives import Adder, MatrixGain, VectorLogSink, ZeroOrderHold

from parapod.diagrams.faults import FaultPoints
from parapod.diagrams.leaves import wiring_of
from parapod.diagrams.own_controller import OWN, own_name
from parapod.diagrams.recording import Recording
from parapod.diagrams.simulators import simulator_of
from parapod.diagrams.station import Station, check_ports
from parapod.diagrams.wiring import (
    add,
    connect,
    connect_by_name,
    idle_inputs,
    inputs_of,
    outputs_of,
)
from parapod.systems.core.errors import WiringError
from parapod.systems.core.quoting import quoted_path

if TYPE_CHECKING:
    from parapod.diagrams.machine import Machine


_AGE = "status.age"


class ClosedLoop[S](Diagram):
    """A machine that can be simulated, by `loop.simulator()`.

    `Simulator(loop)` does for one without a `monitor` and without `plant.accuracy`. The default
    context is the beginning of the scenario.

    Ports of the same name are connected. Station inputs that nothing drives are idle; an input of
    the controller or of a source that nothing drives is an error. Signals with faults go through
    an injector.

    Attributes:
        machine: the machine.
        scenario: the scenario that it was built from.
        station: the machine's station, or the plant that took its place.
        controller: the controller.
        sources: sources of commands.
        faults: places where faults are injected.
        ports: everything that can be recorded, by port name.
        logs: sinks of the recorded signals, by port name.
        sampling_period: time between two of their samples [s].
    """

    def __init__(
        self,
        machine: "Machine[S]",
        scenario: S,
        *,
        meshcat: Meshcat | None = None,
        plant: System | None = None,
        controller: System | Callable[[S], System] | None = None,
        sources: Sequence[System] | None = None,
        log: Collection[str] | None = None,
        log_too: Collection[str] = (),
        injectable: Collection[str] = (),
    ):
        """Builds the closed loop of a scenario.

        Args:
            machine: the machine.
            scenario: one of its scenarios.
            meshcat: scene in which a simulated machine is drawn; None for no drawing.
            plant: a LeafSystem or Diagram in place of the station, with the inputs that the
                controller drives, the outputs that are read, and any others of the station's.
            controller: a system in place of the scenario's controller, or what makes one in place
                of the machine's, unless `control.controller` names another.
            sources: systems in place of the machine's sources of commands.
            log: names of the ports to record; None for all of them.
            log_too: names of further ones, of which those that are there are recorded.
            injectable: points into which faults may be injected later.

        Raises:
            ScenarioError: a scenario that makes no machine.
            WiringError: a system whose ports do not fit, or a port to record that does not exist.
        """
        super().__init__()
        machine = machine.for_scenario(scenario)
        settings: Any = scenario
        period = settings.control.period
        builder = DiagramBuilder()
        sources = machine.sources(scenario) if sources is None else sources
        if not isinstance(controller, System):
            controller = machine.controller_of(scenario, controller, sources)
        machine = machine.with_signals(outputs_of(controller))
        self.machine, self.scenario = machine, scenario
        if plant is not None:
            check_ports(machine, plant, controller, sources)
        self.station: Any = add(builder, plant or Station(machine, scenario, meshcat))
        self.controller: Any = add(builder, controller)
        self.sources: tuple[Any, ...] = tuple(add(builder, source) for source in sources)
        faults = getattr(scenario, "faults", ())
        self.faults = FaultPoints(
            builder, machine.targets, period, faults, settings.seed, injectable
        )
        self.ports = self._connect(builder)
        self.require(log or ())
        logged = None if log is None else {*log, *log_too}
        self.sampling_period: float = machine.view.log_every * period
        self.logs = self._log(builder, logged, self.sampling_period)
        builder.BuildInto(self)
        self.set_name(machine.name)

    def __repr__(self) -> str:
        return f"<closed loop of {self.machine.title}, {getattr(self.scenario, 'backend', '')}>"

    @cached_property
    def form(self) -> Hashable:
        """All that it must share with another loop to be simulated beside it, as rows."""
        return wiring_of(self), self.sampling_period, tuple(self.logs)

    def reset(self, context: Context, scenario: S | None = None) -> None:
        """Puts everything at its beginning.

        Nothing is rebuilt: the same loop serves any seed, ground and imperfection.

        Args:
            context: a context of this diagram.
            scenario: the scenario to begin with; None for the one that the loop was built from.
        """
        self.SetDefaultContext(context)
        context.SetTime(0.0)
        if isinstance(self.station, Station):
            self.station.reset(context, scenario)
        for log in self.logs.values():
            log.FindMutableLog(context).Clear()
        if scenario is not None:
            settings: Any = scenario
            self.faults.set_faults(context, getattr(scenario, "faults", ()), settings.seed)

    def simulator(self, context: Context | None = None) -> Simulator:
        """A simulator with all that the loop needs: its integrator, and its monitor.

        Args:
            context: context to simulate in, which the simulator takes; None for a default one.
        """
        return simulator_of(self, context, self.monitor)

    @property
    def monitor(self) -> Callable[[Context], EventStatus] | None:
        """Monitor that a simulator of the loop needs, see `Station.monitor`; None: none."""
        return self.station.monitor if isinstance(self.station, Station) else None

    def recording(self, context: Context) -> Recording:
        """The signals recorded in a context, by port name."""
        time, signals = np.empty(0), {}
        for name, sink in self.logs.items():
            log = sink.FindLog(context)
            time, signals[name] = log.sample_times().copy(), log.data().T.copy()
        return Recording(time, signals, {name: self.machine.unit(name) for name in signals})

    def require(self, names: Iterable[str]) -> None:
        """Refuses to record signals that are missing.

        Raises:
            WiringError: names them, and those that there are.
        """
        missing = [name for name in names if name not in self.ports]
        if missing and (own := own_name(self.scenario)):
            has = ", ".join(outputs_of(self.controller))
            raise WiringError(
                f"the run records {', '.join(missing)} of the controller, but {OWN} = "
                f"{quoted_path(own)} has only: {has}"
            )
        for name in missing:
            port_names = ", ".join(sorted(self.ports))
            raise WiringError(f"there is no port '{name}' to record; there are: {port_names}")

    def readings(
        self, root_context: Context, names: Collection[str] | None = None
    ) -> dict[str, Callable[[], NDArray[np.float64]]]:
        """By name, what gives the present value of a signal.

        Args:
            root_context: context of the diagram that is simulated.
            names: signals, of which those that the loop has are taken; None for all.
        """
        ports: dict[str, Any] = {
            name: port for name, port in self.ports.items() if names is None or name in names
        }
        return {
            name: partial(port.Eval, port.get_system().GetMyContextFromRoot(root_context))
            for name, port in ports.items()
        }

    def _connect(self, builder: DiagramBuilder) -> dict[str, OutputPort]:
        """Connects everything; returns what can be recorded.

        Raises:
            WiringError: an input of the controller or of a source that nothing drives.
        """
        table = self.machine.table

        held_ports: dict[str, OutputPort] = {}

        def seen(name: str, port: OutputPort) -> OutputPort:
            if name not in table:
                return port
            if table[name].is_sampled and self._commands_devices:
                port = held_ports[name] = self._hold(builder, name, port)
            return self.faults.seen(port, table[name])

        systems = (self.station, self.controller, *self.sources)
        outputs = connect_by_name(builder, systems, seen, skip=(_AGE,)) | held_ports
        for name, port in outputs.items():
            if name in table and self.faults.is_missing(table[name]):
                self.faults.seen(port, table[name])  # for the recording only
        self._connect_ages(builder, outputs)
        idle_inputs(builder, self.station, {port.name: port.idle for port in self.machine.inputs})
        for system in systems:
            for name, sink in inputs_of(system).items():
                if not builder.IsConnectedOrExported(sink):
                    names = ", ".join(sorted(outputs))
                    raise WiringError(
                        f"nothing drives the input '{name}' of '{system.get_name()}'; "
                        f"there are the outputs: {names}"
                    )
        return outputs | self.faults.ports()

    @property
    def _commands_devices(self) -> bool:
        """Whether devices stand behind the station's ports."""
        return isinstance(self.station, Station) and self.station.scenario.backend == "hardware"

    def _hold(self, builder: DiagramBuilder, name: str, port: OutputPort) -> OutputPort:
        """Samples a command at the controllers' instants: a moment later it is another one."""
        settings: Any = self.scenario
        hold = add(builder, ZeroOrderHold(settings.control.period, port.size()), f"held.{name}")
        connect(builder, port, hold.get_input_port())
        return hold.get_output_port()

    def _connect_ages(self, builder: DiagramBuilder, outputs: Mapping[str, OutputPort]) -> None:
        """Connects the devices' ages, with what late signals add to them."""
        sinks = [
            inputs_of(system)[_AGE]
            for system in (self.controller, *self.sources)
            if _AGE in inputs_of(system)
        ]
        if not sinks:
            return
        parts, age = self.machine.parts, outputs[_AGE]
        late = {
            point: parts.index(port.part)
            for point, port in self.faults.aged().items()
            if port.part in parts
        }
        if late:
            total = add(builder, Adder(1 + len(late), len(parts)), "ages")
            connect(builder, age, total.get_input_port(0))
            for k, (point, part) in enumerate(late.items(), start=1):
                element = np.eye(len(parts))[:, [part]]
                added = add(builder, MatrixGain(element), f"age_of_{point}")
                extra = self.faults.injectors[point].GetOutputPort("extra_age")
                connect(builder, extra, added.get_input_port())
                connect(builder, added.get_output_port(), total.get_input_port(k))
            age = total.get_output_port()
        for sink in sinks:
            connect(builder, age, sink)

    def _log(
        self, builder: DiagramBuilder, names: Collection[str] | None, period: float
    ) -> dict[str, VectorLogSink]:
        sinks = {}
        for name, port in self.ports.items():
            if names is None or name in names:
                # Not `LogVectorOutput`, whose sink would never let go of the diagram.
                sinks[name] = add(builder, VectorLogSink(port.size(), period), f"log.{name}")
                connect(builder, port, sinks[name].get_input_port())
        return sinks
