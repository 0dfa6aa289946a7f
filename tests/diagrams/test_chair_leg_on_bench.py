"""The walking chair's leg under the bench's slide: it stands, steps and follows, loops closed."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import EventStatus

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.terrain_simulator.chair_leg import ChairLeg
from parapod.diagrams.terrain_simulator.machine import TERRAIN_BENCH
from parapod.sims.terrain_simulator.leg import chair_leg_scenario
from parapod.sims.terrain_simulator.walk import check_bench
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.walking_chair.checks import ForceExceeded, SpeedExceeded, StrokeExceeded
from parapod.systems.walking_chair.geometry import ChairGeometry

CHAIR_GEOMETRY = ChairGeometry()

# Largest errors of the standing and the swinging foot [m], about a third above those measured.
STANCE, SWING = 0.25e-3, 0.16e-3
CLOSED = 20e-6  # [m]


def walked(scenario, duration):
    """Recording, and largest gap of the leg's loops [m] at a step of 1 ms."""
    loop = ClosedLoop(TERRAIN_BENCH, scenario)
    leg, plant = scenario.leg.under_test, loop.station.behind.handle.plant.model.plant
    simulator, gaps = Simulator(loop), []
    loop.reset(simulator.get_mutable_context())

    def watch(root):
        gaps.append(leg.loop_error(plant, plant.GetMyContextFromRoot(root)).max())
        return EventStatus.DidNothing()

    simulator.set_monitor(watch)
    simulator.AdvanceTo(duration)
    assert len(gaps) > 500 * duration
    return loop.recording(simulator.get_context()), max(gaps)


def one_step(slope):
    """A scenario of one stride that stands but briefly before and after it."""
    scenario = chair_leg_scenario(slope)
    gait = replace(scenario.gait, strides=1)
    return replace(scenario, gait=gait, begin=0.1, shift=0.2, end=0.1)


@pytest.mark.parametrize("ahead", [0.0, -40.0], ids=["on its whole sole", "on its edge"])
def test_it_stands_with_its_share_of_chair_and_passenger(ahead):
    scenario = chair_leg_scenario()
    scenario.begin, scenario.leg.chair.ahead_mm = 2.0, ahead
    assert scenario.hip.mass_kg == pytest.approx((49.2 + 57.0) / 4.0)
    run, gap = walked(scenario, 1.3)
    force, weight = run["truth.foot_force"][-100:, 1], (49.2 + 57.0) / 4.0 * 9.81
    np.testing.assert_allclose(force, weight, rtol=1e-3)
    assert gap < CLOSED
    leg, phi = scenario.leg.under_test, np.zeros(1)
    place = leg.places(run["leg.position"][-1:], phi)[0]
    # Screws give under the load as the chair's do, by 1 um for a newton.
    asked = scenario.walk.at(0.0).foot[0]
    assert 20e-6 < place[1] - asked[1] < STANCE


@pytest.mark.parametrize("slope", [pytest.param(0.0, marks=pytest.mark.slow), 10.0])
def test_it_steps_and_follows_with_all_loops_closed(slope):
    scenario = one_step(slope)
    walk, leg = scenario.walk, scenario.leg.under_test
    check_bench(scenario)
    run, gap = walked(scenario, walk.duration + scenario.end)
    assert max(gap, run["truth.loop_error"].max()) < CLOSED
    asked = walk.at(run.time)
    places = leg.places(run["leg.position"], asked.pose[0, :, 2])
    off = np.linalg.norm(places - asked.foot[0], axis=-1)
    assert off[asked.stance].max() < STANCE
    assert off[~asked.stance].max() < SWING
    # It does step: by 48 mm along the ground while it stands, and off it in between.
    x = places[asked.stance & (asked.force > 10.0), 0]
    assert np.ptp(x) == pytest.approx(0.048, abs=4e-3)
    along, upwards = run["truth.foot_force"].T
    flown = (run.time > walk.lift_off + 0.1) & (run.time < walk.lift_off + walk.swing - 0.1)
    assert not upwards[flown].any()
    off_load = upwards - asked.force
    assert np.sqrt(np.mean(off_load**2)) < 0.03 * walk.support.peak
    pressed = upwards > 0.2 * walk.support.peak
    assert np.abs(along[pressed] / upwards[pressed]).max() < 0.2
    assert np.abs(run["hip.position"][:, 0] - walk.hip[1]).max() < 1e-3
    assert np.abs(run["leg.torque_command"]).max() < leg.max_torque[0]


def refused(error, text, **changes):
    scenario = chair_leg_scenario(changes.pop("slope", 0.0))
    for name, value in changes.items():
        part, key = name.split("__")
        setattr(scenario.leg.chair if part == "chair" else getattr(scenario, part), key, value)
    with pytest.raises(error, match=text) as found:
        check_bench(scenario)
    assert isinstance(found.value, ParapodError)
    assert "\n" not in str(found.value)


def test_what_the_leg_cannot_do_is_refused_by_the_branch():
    refused(
        StrokeExceeded,
        r"branch 12 would need a length of .* mm at .* s, .* outside its stroke 574\.0\.\.874\.0",
        place__hip_mm=970.0,
    )
    refused(StrokeExceeded, r"branch 11 has no length", place__hip_mm=60.0)
    refused(SpeedExceeded, r"branch 12 .* than its limit 80\.0 mm/s", gait__speed_m_s=0.1)
    # On the corner E_1 alone the UP branch would bear all; uphill a front leg's bears more still.
    refused(ForceExceeded, r"branch 11 would have to hold 52", chair__ahead_mm=0.0)
    refused(
        ForceExceeded,
        r"branch 11 would have to hold 7",
        slope=10.0,
        chair__turned=False,
        chair__ahead_mm=-29.0,
    )


def test_a_loop_that_is_opened_is_told_by_how_much():
    """A screw of a UPS branch that turns without the rest opens the loop of its branch alone."""
    scenario = chair_leg_scenario()
    loop = ClosedLoop(TERRAIN_BENCH, scenario, log=())
    plant = loop.station.behind.handle.plant.model.plant
    root = loop.CreateDefaultContext()
    loop.reset(root)
    context, leg = plant.GetMyContextFromRoot(root), scenario.leg.under_test
    closed = leg.loop_error(plant, context)
    assert closed.max() < CLOSED
    for k, name in enumerate(("ups_2", "ups_3")):
        screw = plant.GetJointByName(f"{name}_length")
        was = screw.get_translation(context)
        screw.set_translation(context, was + 5e-3)
        opened = leg.loop_error(plant, context)
        screw.set_translation(context, was)
        assert opened[k] == pytest.approx(5e-3, abs=CLOSED)
        assert opened[1 - k] == pytest.approx(closed[1 - k])


def test_a_lighter_chair_may_roll_over_its_whole_sole():
    """37.9 kg are the payload that the UP branches of two legs bear alone."""
    scenario = chair_leg_scenario()
    scenario.leg.chair.ahead_mm, scenario.hip.mass_kg = 0.0, (49.2 + 37.0) / 4.0
    check_bench(scenario)
    refused(ForceExceeded, "branch 11", chair__ahead_mm=0.0, hip__mass_kg=(49.2 + 39.0) / 4.0)


def test_a_period_too_long_for_the_screws_loops_is_refused():
    with pytest.raises(ScenarioError, match=r"control.period = 0.01 s .* it is 0.0033 s at most"):
        ChairLeg().make_controller(0.01)


def test_the_leg_of_the_bench_is_that_of_the_chair():
    """Its joints are as the chair's are, and it is as heavy as the bodies of its file."""
    scenario = chair_leg_scenario()
    leg, walk = scenario.leg.under_test, scenario.walk
    loop = ClosedLoop(TERRAIN_BENCH, scenario, log=())
    plant = loop.station.behind.handle.plant.model.plant
    instance = plant.GetModelInstanceByName("leg")
    context = plant.GetMyContextFromRoot(loop.CreateDefaultContext())
    assert plant.CalcTotalMass(context, [instance]) == pytest.approx(leg.mass)
    slide = plant.GetModelInstanceByName("slide")
    hung = plant.CalcTotalMass(context, [instance, slide])
    assert hung == pytest.approx((49.2 + 57.0) / 4.0)
    assert leg.loop_error(plant, context).max() < 1e-12
    # In the default context each screw is as long as its port says, the foot on the plate.
    for name, length in zip(leg.names, leg.reach(walk.at(0.0).foot[0], 0.0), strict=True):
        joint = plant.GetJointByName(name, instance)
        assert joint.get_translation(context) == pytest.approx(length)
    corners = plant.CalcPointsPositions(
        context, plant.GetFrameByName("foot", instance), CHAIR_GEOMETRY.leg.corners.T,
        plant.world_frame(),
    )  # fmt: skip
    assert corners[2].min() == pytest.approx(walk.at(0.0).pose[0, 1], abs=1e-9)
    assert math.dist(corners[::2, 0], corners[::2, 1]) == pytest.approx(0.10392, abs=1e-5)
