"""A simulated machine behind emulated devices."""

import fcntl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, InputPort, OutputPort

from parapod.diagrams.machines import machine_of
from parapod.diagrams.ports import PortSpec
from parapod.sims.emulated_devices import emulated_devices
from parapod.sims.real_time import RealTimeLoop
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.ports import read_array
from parapod.systems.hardware.addresses import WIRES, emulator_directory
from parapod.systems.hardware.emulation.harness import SharedHarness


class EmulatedMachine:
    """A simulated station whose ports are wires to emulated devices.

    Attributes:
        description: of the machine.
        harness: the wires.
        misbehaviours: by part of the machine.
        period: between two exchanges of wires and physics [s].
    """

    def __init__(self, scenario: Any):
        """Builds the machine, in the state in which the scenario's job begins.

        Args:
            scenario: of a machine; its backend must be a simulated one; its drivers are emulated.

        Raises:
            ScenarioError: no machine's, another backend, or an emulator runs already.
        """
        self.description = machine = machine_of(scenario)
        if scenario.backend not in machine.simulated:
            raise ScenarioError(
                f"backend = '{scenario.backend}' cannot be behind emulated devices; "
                f"there are: {', '.join(machine.simulated)}",
                "backend",
            )
        self._scenario = scenario
        # A longer step of the plant makes it rarer.
        step = 0.0 if scenario.backend == "kinematic" else scenario.plant.time_step
        self.period = max(machine.simulated[scenario.backend], step)
        self._station = machine.make_station(machine.behind_devices(scenario, self.period))
        self._simulator = Simulator(self._station.diagram)
        self._context = self._simulator.get_mutable_context()
        self._station.reset(self._context)
        self._sizes = {spec.name: spec.size for spec in (*machine.inputs, *machine.outputs)}
        self._parts = sorted({driver.part for driver in scenario.hardware.drivers})
        directory = emulator_directory()
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._lock = _locked(directory)
        self._wires = directory / WIRES
        self.harness = SharedHarness(self._wires, self._sizes, self._parts, is_new=True)
        self.misbehaviours = {part: self.harness.misbehaviour(part) for part in self._parts}
        diagram = self._station.diagram
        self._outputs: list[tuple[str, OutputPort]]
        self._outputs = [(spec.name, diagram.GetOutputPort(spec.name)) for spec in machine.outputs]
        for spec in machine.inputs:
            self.harness.set(spec.name, [machine.idle.get(spec.name, 0.0)] * spec.size)
            self._port(spec).FixValue(self._context, self.harness.get(spec.name))
        self._show()

    def _port(self, spec: PortSpec) -> InputPort:
        return self._station.diagram.GetInputPort(spec.name)

    @contextmanager
    def devices(self) -> Iterator[None]:
        """While it lasts the emulated devices answer at the addresses of the scenario's drivers.

        Raises:
            ScenarioError: a driver has no emulator, or an address that is not the emulator's.
        """
        drivers, seed = self._scenario.hardware.drivers, self._scenario.seed
        try:
            with emulated_devices(drivers, self._wires, self._sizes, self._parts, seed):
                yield
        finally:
            self._wires.unlink(missing_ok=True)
            self._lock.close()

    def run(self, duration: float, on_tick: Callable[[Context], None]) -> None:
        """Simulates in real time; late ticks are left out.

        Args:
            duration: [s].
            on_tick: told the context after each tick.
        """
        inputs = [(spec.name, self._port(spec)) for spec in self.description.inputs]

        def exchange(root: Context) -> None:
            self._show()
            for name, port in inputs:
                port.FixValue(root, self.harness.get(name))
            on_tick(root)

        self._simulator.Initialize()
        RealTimeLoop(self._simulator, self.period, exchange, is_strict=False).run(duration)

    def _show(self) -> None:
        """Puts what the station shows on the wires."""
        for name, port in self._outputs:
            self.harness.set(name, np.asarray(port.Eval(self._context)).tolist())

    def ports(self) -> dict[str, str]:
        """Names and units of what can be logged."""
        machine = self.description
        specs = (*machine.inputs, *machine.outputs, *machine.truth)
        return {spec.name: spec.unit for spec in specs}

    def values(self, root: Context) -> list[NDArray[np.float64]]:
        """Of all ports that can be logged."""
        machine, diagram = self.description, self._station.diagram
        taken = [read_array(self._port(spec), root) for spec in self.description.inputs]
        specs = (*machine.outputs, *machine.truth)
        shown = [np.asarray(diagram.GetOutputPort(spec.name).Eval(root)) for spec in specs]
        return taken + shown


def _locked(directory: Path) -> IO[str]:
    """The folder's lock file, locked until it is closed or the process ends.

    Raises:
        ScenarioError: another process has locked it.
    """
    lock = open(directory / "lock", "w")  # noqa: SIM115 (kept open on purpose)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        raise ScenarioError(
            f"an emulator runs in '{directory}' already; end it, or name another folder in the "
            "environment's PARAPOD_EMULATOR"
        ) from None
    return lock
