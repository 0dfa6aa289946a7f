import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.scenario import ChairScenario, GaitScenario
from parapod.systems.walking_chair.gait import Walk
from parapod.systems.walking_chair.masses import Passenger
from parapod.systems.walking_chair.model import CHAIR_GEOMETRY

SIGNALS = (
    "gait_time",
    "done",
    "hold",
    "support",
    "support_margin",
    "payload_estimated",
    "legs.position",
    "legs.velocity_command",
    "truth.body_position",
    "truth.body_attitude",
    "truth.foot_height",
    "truth.force",
    "truth.loop_error",
)


def scenario_for(backend="kinematic", **changes):
    scenario = ChairScenario(backend=backend, begin=0.5, end=0.5)
    scenario.plant.time_step = 5e-3
    for path, value in changes.items():
        part, _, name = path.partition("__")
        setattr(getattr(scenario, part), name, value)
    return scenario


def run(scenario, until=None, actual=None):
    """Signals of a walk; `actual` is what the station really has."""
    loop = ClosedLoop(CHAIR, scenario, log=SIGNALS)
    simulator = Simulator(loop)
    loop.reset(simulator.get_mutable_context(), actual)
    simulator.Initialize()
    whole = scenario.begin + scenario.gait.walk.duration + scenario.end
    simulator.AdvanceTo(whole if until is None else until)
    recording = loop.recording(simulator.get_context())
    time, signals = recording.time, recording
    return time, signals


def error_of(scenario, signals):
    motion = scenario.gait.walk.motions(CHAIR_GEOMETRY, signals["gait_time"][:, 0])
    return signals["truth.body_position"] - np.asarray(motion.body.position)


@pytest.fixture(scope="module")
def walked():
    scenario = scenario_for("multibody")
    return scenario, *run(scenario)


def test_the_body_follows_the_gait(walked):
    scenario, time, signals = walked
    error = error_of(scenario, signals)[time > 0.3]
    assert np.linalg.norm(error, axis=1).max() < 1e-3
    assert np.degrees(np.abs(signals["truth.body_attitude"][:, :2])).max() < 0.1
    assert signals["done"][-1, 0] == 1.0


def test_feet_go_up_as_planned_and_never_into_the_ground(walked):
    _, _, signals = walked
    heights = signals["truth.foot_height"].reshape(-1, 4, 3)
    assert heights.min() > -2e-5
    assert heights.min(axis=2).max(axis=0) == pytest.approx([0.1] * 4, abs=1e-3)
    stands = signals["support"] > 0.5
    assert heights.min(axis=2)[stands].max() < 1e-3


def test_forces_stay_far_below_what_the_actuators_can(walked):
    _, time, signals = walked
    assert np.abs(signals["truth.force"][time > 0.3]).max() < 250.0


def test_the_payload_is_known_from_the_currents_while_walking(walked):
    scenario, time, signals = walked
    payload = signals["payload_estimated"][time > scenario.begin]
    np.testing.assert_allclose(payload[:, 0], 57.0, rtol=0, atol=0.5)
    assert 1e3 * np.abs(payload[:, 1:]).max() < 8.0


def test_the_margin_is_that_of_the_gait(walked):
    scenario, time, signals = walked
    margin = signals["support_margin"][time > scenario.begin]
    assert not signals["hold"].any()
    assert 0.045 < margin.min() < 0.058


def test_commands_begin_at_rest(walked):
    _, time, signals = walked
    early = np.abs(signals["legs.velocity_command"][time < 0.5])
    # Drives creep by a millimetre a second, which is all that is to be corrected.
    assert early.max() < 5e-3


@pytest.mark.parametrize(("order", "way"), [("13-24", "back"), ("24-13", "forward and back")])
def test_other_orders_and_ways_are_followed_too(order, way):
    scenario = scenario_for(
        "kinematic", gait__order=order, gait__way=way, gait__phase_duration=5.0
    )
    time, signals = run(scenario)
    error = error_of(scenario, signals)[time > 0.3]
    assert np.linalg.norm(error, axis=1).max() < 1e-3
    goal = {"back": -0.1027, "forward": 0.1027}.get(way, 0.0)
    assert signals["truth.body_position"][-1, 1] == pytest.approx(goal, abs=2e-4)


def test_velocity_mode_keeps_an_error_that_compound_mode_removes():
    worst = {}
    for mode in ("velocity", "compound"):
        scenario = scenario_for("kinematic", control__mode=mode)
        time, signals = run(scenario, until=5.5)
        motion = scenario.gait.walk.motions(CHAIR_GEOMETRY, signals["gait_time"][:, 0])
        assert np.isfinite(np.asarray(motion.body.position)).all()
        error = error_of(scenario, signals)[time > 1.0]
        worst[mode] = np.linalg.norm(error, axis=1).max()
    assert worst["compound"] < 0.5 * worst["velocity"]


def test_a_passenger_who_leans_out_stops_the_gait_before_a_foot_is_lifted():
    # Nobody has told the controller: it is in the currents.
    leaning = scenario_for("multibody", passenger__x_mm=100.0, passenger__y_mm=50.0)
    _, signals = run(scenario_for("multibody"), until=9.0, actual=leaning)
    assert signals["hold"][-1, 0] == 1.0
    assert signals["done"][-1, 0] == 0.0
    assert signals["gait_time"][-1, 0] <= 5.0 + 1e-9
    assert signals["truth.foot_height"].max() < 1e-3
    assert signals["payload_estimated"][-1, 1:] == pytest.approx([0.10, 0.05], abs=5e-3)
    # Wrongly let go it would fall: see the negative margin.
    assert signals["support_margin"][-1, 0] < 0.0


def test_a_passenger_who_sits_up_again_is_carried_on():
    leaning = scenario_for("kinematic", passenger__x_mm=100.0, passenger__y_mm=50.0)
    scenario = scenario_for("kinematic")
    loop = ClosedLoop(CHAIR, scenario, log=SIGNALS)
    simulator = Simulator(loop)
    context = simulator.get_mutable_context()
    loop.reset(context, leaning)
    simulator.Initialize()
    simulator.AdvanceTo(8.0)
    assert loop.recording(context)["hold"][-1, 0] == 1.0
    loop.station.behind.handle.plant.seat(context, Passenger(57.0))
    simulator.AdvanceTo(16.0)
    signals = loop.recording(context)
    assert signals["hold"][-1, 0] == 0.0
    assert signals["gait_time"][-1, 0] > 7.0


def test_ways_of_the_scenario_are_walks():
    assert isinstance(GaitScenario(way="forward").walk, Walk)
    assert GaitScenario(way="forward", cycles=3).walk.gaits[0].end[1] == pytest.approx(0.3081)
    assert GaitScenario(way="back").walk.gaits[0].end[1] == pytest.approx(-0.1027)
    assert GaitScenario(way="forward and back").walk.gaits[-1].end == pytest.approx((0.0, 0.0))
