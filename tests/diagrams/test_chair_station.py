import numpy as np
import pytest
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.station import Station
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.scenario import SIMULATED, ChairScenario
from parapod.diagrams.wiring import idle_inputs
from parapod.systems.walking_chair.gait import starting_lengths
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import Passenger

CHAIR_GEOMETRY = ChairGeometry()


def scenario_for(backend, **changes):
    scenario = ChairScenario(backend=backend)
    scenario.plant.time_step = 2e-3
    for path, value in changes.items():
        part, _, name = path.partition("__")
        setattr(getattr(scenario, part) if name else scenario, name or part, value)
    return scenario


class Held:
    """A station whose inputs are held, in a diagram of its own."""

    def __init__(self, scenario, command=None):
        builder = DiagramBuilder()
        self.station = Station(CHAIR, scenario)
        builder.AddSystem(self.station)
        idle_inputs(builder, self.station, {"legs.brake": 1.0} if command is None else {})
        if command is not None:
            source = builder.GetSubsystemByName("idle.legs.velocity_command")
        self.simulator = Simulator(builder.Build())
        self.context = self.simulator.get_mutable_context()
        self.station.reset(self.context)
        if command is not None:
            own = source.GetMyMutableContextFromRoot(self.context)
            source.get_mutable_source_value(own).SetFromVector(command)

    def shown(self, name):
        context = self.station.GetMyContextFromRoot(self.context)
        return self.station.GetOutputPort(name).Eval(context)


@pytest.mark.parametrize("backend", [*SIMULATED, "mock"])
def test_a_braked_chair_stays_where_its_walk_begins(backend):
    held = Held(scenario_for(backend))
    held.simulator.AdvanceTo(0.5)
    lengths = starting_lengths(CHAIR_GEOMETRY, held.station.scenario.walk).ravel()
    count = 1e-3 * held.station.scenario.machine.drives.encoder_resolution_mm
    np.testing.assert_allclose(held.shown("legs.position"), lengths, rtol=0, atol=count)
    np.testing.assert_array_equal(held.shown("legs.velocity"), 0.0)
    assert not held.shown("status.fault").any()
    if backend in SIMULATED:
        np.testing.assert_allclose(
            held.shown("truth.body_position"), (0.0, 0.0, 0.6654), rtol=0, atol=1e-4
        )


@pytest.mark.parametrize("backend", [*SIMULATED, "mock"])
def test_branches_follow_their_velocities(backend):
    exact = scenario_for(backend, drives__gain_error=0.0, drives__offset_mm_s=0.0)
    command = np.tile((0.02, 0.0197, 0.0197), 4)
    held = Held(exact, command)
    start = held.shown("legs.position").copy()
    held.simulator.AdvanceTo(0.5)
    tau = 0.0 if backend == "mock" else 0.04
    moved = held.shown("legs.position") - start
    # A lag and the sampling of the command come off.
    np.testing.assert_allclose(moved, command * (0.5 - tau), rtol=0, atol=0.02 * 0.011)
    np.testing.assert_allclose(held.shown("legs.velocity"), command, rtol=0, atol=6e-4)


@pytest.mark.parametrize("backend", SIMULATED)
def test_currents_are_the_forces_of_the_branches(backend):
    held = Held(scenario_for(backend))
    held.simulator.AdvanceTo(0.5)
    force = held.shown("truth.force")
    np.testing.assert_allclose(held.shown("legs.current"), force * 3.0 / 427.3, rtol=1e-9)
    weight = (57.0 + 49.2) * 9.81
    assert held.shown("truth.contact_force").sum() == pytest.approx(weight, rel=1e-3)
    # They hold what is above the feet.
    assert force.reshape(4, 3).sum() == pytest.approx((57.0 + 49.2 - 8.0) * 9.81, rel=0.02)


def test_both_plants_share_the_load_alike():
    forces = {}
    for backend in SIMULATED:
        held = Held(scenario_for(backend, passenger__x_mm=40.0, passenger__y_mm=-30.0))
        held.simulator.AdvanceTo(0.5)
        forces[backend] = held.shown("truth.force").copy()
    np.testing.assert_allclose(forces["kinematic"], forces["multibody"], rtol=0, atol=12.0)
    by_leg = {name: force.reshape(4, 3).sum(axis=1) for name, force in forces.items()}
    np.testing.assert_allclose(by_leg["kinematic"], by_leg["multibody"], rtol=0.035)


def test_imperfections_come_from_the_seed():
    commands = np.full(12, 0.02)
    moved = []
    for seed in (0, 0, 1):
        held = Held(scenario_for("kinematic", seed=seed), commands)
        start = held.shown("truth.position").copy()
        held.simulator.AdvanceTo(0.3)
        moved.append(held.shown("truth.position") - start)
    np.testing.assert_array_equal(moved[0], moved[1])
    assert np.abs(moved[0] - moved[2]).max() > 1e-5
    # Gains within 2 %, offsets within 1 mm/s.
    assert np.ptp(moved[0]) < 0.3 * (2 * 0.02 * 0.02 + 2e-3)


@pytest.mark.parametrize("backend", SIMULATED)
def test_a_station_can_begin_again_with_another_passenger(backend):
    station_scenario = scenario_for(backend)
    loop = ClosedLoop(CHAIR, station_scenario, log=("truth.force",))
    simulator = Simulator(loop)
    ends = []
    for mass in (57.0, 20.0, 57.0):
        other = scenario_for(backend, passenger__mass_kg=mass)
        loop.reset(simulator.get_mutable_context(), other)
        simulator.Initialize()
        simulator.AdvanceTo(0.3)
        signals = loop.recording(simulator.get_context())
        ends.append(signals["truth.force"][-1])
    assert ends[1].sum() < 0.75 * ends[0].sum()
    np.testing.assert_allclose(ends[2], ends[0], rtol=1e-6)


@pytest.mark.parametrize("backend", SIMULATED)
def test_the_chair_is_drawn(backend):
    meshcat = Meshcat()
    loop = ClosedLoop(CHAIR, scenario_for(backend), meshcat=meshcat, log=())
    simulator = Simulator(loop)
    loop.reset(simulator.get_mutable_context())
    simulator.Initialize()
    simulator.AdvanceTo(0.05)
    for path in ("chair/body/body", "chair/leg_3/foot", "chair/passenger/passenger"):
        assert meshcat.HasPath(path)


@pytest.mark.parametrize("backend", SIMULATED)
def test_the_figure_of_the_passenger_sits_where_the_passenger_does(backend):
    loop = ClosedLoop(CHAIR, scenario_for(backend), meshcat=Meshcat(), log=())
    simulator = Simulator(loop)
    context = simulator.get_mutable_context()
    (scene,) = (s for s in loop.station.GetSystems() if isinstance(s, SceneGraph))

    def place(frame):
        query = scene.get_query_output_port().Eval(scene.GetMyContextFromRoot(context))
        inspector = query.inspector()
        (found,) = (
            i
            for i in inspector.GetAllFrameIds()
            if inspector.GetName(i).endswith(f"::{frame}") and inspector.NumGeometriesForFrame(i)
        )
        return query.GetPoseInWorld(found).translation()

    first = place("passenger") - place("body")
    np.testing.assert_allclose(first, Passenger().place, atol=1e-3)
    loop.station.behind.handle.plant.seat(context, Passenger(57.0, 0.05, -0.04))
    moved = place("passenger") - place("body") - first
    np.testing.assert_allclose(moved, (0.05, -0.04, 0.0), atol=1e-3)
