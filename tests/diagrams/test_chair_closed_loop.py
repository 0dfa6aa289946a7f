"""The chair's station and controller together; a whole walk of the paper is `chair-walk`'s."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.alone import Alone
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.walking_chair.controller import make_controller
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.scenario import ChairScenario, GaitScenario
from parapod.systems.walking_chair.gait import Walk, starting_lengths
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import Passenger
from parapod.systems.walking_chair.payload import PayloadEstimator

CHAIR_GEOMETRY = ChairGeometry()

SIGNALS = (
    "gait_time",
    "done",
    "hold",
    "support_margin",
    "payload_estimated",
    "truth.body_position",
    "truth.foot_height",
)
# Low steps, which need less time.
LOW = {"lift_mm": 45.0, "step_mm": 30.0, "swing_height_mm": 30.0, "phase_duration": 2.0}


def scenario_for(backend="kinematic", **changes):
    scenario = ChairScenario(backend=backend, begin=0.5, end=0.5, gait=GaitScenario(**LOW))
    scenario.plant.time_step = 5e-3
    for path, value in changes.items():
        part, _, name = path.partition("__")
        setattr(getattr(scenario, part), name, value)
    return scenario


def begun(scenario, actual=None):
    """A simulator of the scenario and its loop; `actual` is what the station really has."""
    loop = ClosedLoop(CHAIR, scenario, log=SIGNALS)
    simulator = Simulator(loop)
    loop.reset(simulator.get_mutable_context(), actual)
    simulator.Initialize()
    return simulator, loop


def errors_of(scenario, until):
    """Distances of the body from where the gait has it, once the chair stands, and signals."""
    simulator, loop = begun(scenario)
    simulator.AdvanceTo(until)
    signals = loop.recording(simulator.get_context())
    motion = scenario.walk.motions(CHAIR_GEOMETRY, signals["gait_time"][:, 0])
    error = signals["truth.body_position"] - np.asarray(motion.body.position)
    return np.linalg.norm(error[signals.time > 0.3], axis=1), signals


def test_a_controller_is_that_of_the_chair_that_it_is_given():
    """Nodes, payload and margin before the gait begins, beside those of the systems alone."""
    other = replace(CHAIR_GEOMETRY, leg=replace(CHAIR_GEOMETRY.leg, b=0.21, a=0.19))
    scenario = scenario_for()
    scenario.begin = 10.0
    walk, force = scenario.walk, np.full(12, 100.0)
    start = starting_lengths(CHAIR_GEOMETRY, walk).ravel()
    margins = []
    for geometry in (CHAIR_GEOMETRY, other):
        scenario.machine.leg.a_mm = 1e3 * geometry.leg.a
        scenario.machine.leg.b_mm = 1e3 * geometry.leg.b
        controller = make_controller(scenario)
        simulator = Simulator(controller)
        context = simulator.get_mutable_context()
        payload = Alone(PayloadEstimator(geometry=geometry), {"position": start, "current": force})
        controller.GetInputPort("legs.position").FixValue(context, start)
        controller.GetInputPort("legs.current").FixValue(context, force)
        simulator.AdvanceTo(2.0)
        shown = {
            name: controller.GetOutputPort(name).Eval(context)
            for name in ("position_node", "payload_estimated", "support_margin")
        }
        lengths = starting_lengths(geometry, walk).ravel()
        np.testing.assert_allclose(shown["position_node"], lengths, atol=1e-12)
        alone = Simulator(payload)
        alone.AdvanceTo(2.0)
        expected = payload.recording(alone.get_context())["payload"][-1]
        np.testing.assert_allclose(shown["payload_estimated"], expected, atol=1e-9)
        margins.append(shown["support_margin"].item())
    assert margins[0] != margins[1]


def test_a_walk_back_is_followed():
    scenario = scenario_for(gait__way="back")
    whole = scenario.begin + scenario.walk.duration + scenario.end
    errors, signals = errors_of(scenario, whole)
    assert errors.max() < 1e-3
    assert signals["truth.body_position"][-1, 1] == pytest.approx(-0.03, abs=2e-4)
    assert signals["done"][-1, 0] == 1.0


def test_velocity_mode_keeps_an_error_that_compound_mode_removes():
    compound, velocity = (
        errors_of(scenario_for(control__mode=mode), 2.5)[0][70:].max()
        for mode in ("compound", "velocity")
    )
    assert compound < 0.5 * velocity


def test_a_passenger_who_leans_out_stops_the_gait_before_a_foot_is_lifted():
    # Nobody has told the controller: it is in the currents.
    leaning = scenario_for("multibody", passenger__x_mm=100.0, passenger__y_mm=50.0)
    simulator, loop = begun(scenario_for("multibody"), leaning)
    simulator.AdvanceTo(4.5)
    signals = loop.recording(simulator.get_context())
    assert signals["hold"][-1, 0] == 1.0
    assert signals["done"][-1, 0] == 0.0
    assert signals["gait_time"][-1, 0] <= 2.0 + 1e-9
    assert signals["truth.foot_height"].max() < 1e-3
    assert signals["payload_estimated"][-1, 1:] == pytest.approx([0.10, 0.05], abs=5e-3)
    # Wrongly let go it would fall: see the negative margin.
    assert signals["support_margin"][-1, 0] < 0.0


def test_a_passenger_who_sits_up_again_is_carried_on():
    leaning = scenario_for(passenger__x_mm=100.0, passenger__y_mm=50.0)
    simulator, loop = begun(scenario_for(), leaning)
    context = simulator.get_mutable_context()
    simulator.AdvanceTo(3.0)
    held = loop.recording(context)
    assert held["hold"][-1, 0] == 1.0
    assert held["gait_time"][-1, 0] <= 2.0
    loop.station.behind.handle.plant.seat(context, Passenger(57.0))
    simulator.AdvanceTo(6.5)
    signals = loop.recording(context)
    assert signals["hold"][-1, 0] == 0.0
    assert signals["gait_time"][-1, 0] > 2.2


def test_ways_of_the_scenario_are_walks():
    def end_of(way, cycles=1):
        walk = GaitScenario(way=way, cycles=cycles).walk_of(CHAIR_GEOMETRY.leg)
        assert isinstance(walk, Walk)
        return walk.gaits[-1].end

    assert end_of("forward", 3)[1] == pytest.approx(0.3081)
    assert end_of("back")[1] == pytest.approx(-0.1027)
    assert end_of("forward and back") == pytest.approx((0.0, 0.0))
