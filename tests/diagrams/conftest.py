import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.model import DRAWN, add_platform
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import add, connect
from parapod.systems.levelling_platform.model import FootTruth


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


class Model:
    """A platform that is put down without a simulation, and what is read from it."""

    def __init__(self, variant, geometry=DRAWN, foot_offsets=(0.0,) * 4):
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
        self.model = add_platform(
            self.plant, variant, geometry=geometry, foot_offsets=foot_offsets
        )
        self.feet = add(builder, FootTruth(self.model))
        for name, port in (
            ("contact_results", self.plant.get_contact_results_output_port()),
            ("body_poses", self.plant.get_body_poses_output_port()),
        ):
            connect(builder, port, self.feet.GetInputPort(name))
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)
        self.offsets = foot_offsets

    def stand(self, extension, ground):
        positions = self.model.standing_positions(extension, ground, self.offsets)
        self.model.put(self.context, positions, ground, self.offsets)
        self.feet.set_ground(
            self.feet.GetMyMutableContextFromRoot(self.root), ground, self.offsets
        )

    def read(self, name):
        context = self.feet.GetMyContextFromRoot(self.root)
        return np.array(self.feet.GetOutputPort(name).Eval(context))


@pytest.fixture(scope="session")
def make_model():
    """make_model(variant, geometry, foot_offsets): see `Model`."""
    return Model


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
