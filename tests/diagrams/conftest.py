import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.station import Station


class Machine:
    """The platform's station at its beginning, whose ports are set and read by their names.

    Inputs are zero and the wheels are braked until a test says otherwise.
    """

    def __init__(self, scenario):
        self.station = Station(PLATFORM, scenario)
        self.simulator = Simulator(self.station)
        self.context = self.simulator.get_mutable_context()
        self.reset()

    def reset(self, scenario=None):
        self.station.SetDefaultContext(self.context)
        self.context.SetTime(0.0)
        for spec in PLATFORM.inputs:
            self.set(spec.name, 0.0)
        self.set("wheels.brake", 1.0)
        self.station.reset(self.context, scenario)
        self.simulator.Initialize()

    def set(self, name, value):
        port = self.station.GetInputPort(name)
        port.FixValue(self.context, np.broadcast_to(value, port.size()).astype(float))

    def read(self, name):
        return np.array(self.station.GetOutputPort(name).Eval(self.context))

    def run(self, duration):
        self.simulator.AdvanceTo(self.context.get_time() + duration)

    def record(self, duration, *names, period):
        """Samples (n, size) of outputs, taken every period."""
        rows = []
        for _ in range(round(duration / period)):
            self.run(period)
            rows.append([self.read(name) for name in names])
        return [np.array(column) for column in zip(*rows, strict=True)]


@pytest.fixture(scope="session")
def make_machine():
    """make_machine(scenario): see `Machine`."""
    return Machine


@pytest.fixture(scope="session")
def record():
    """record(loop, until, scenario): a recording from the beginning of the loop's scenario."""

    def run(loop, until, scenario=None):
        simulator = Simulator(loop)
        context = simulator.get_mutable_context()
        loop.reset(context, scenario)
        simulator.Initialize()
        simulator.AdvanceTo(until)
        return loop.recording(context)

    return run
