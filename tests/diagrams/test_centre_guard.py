"""Signs at which the guard of a machining centre ends a job, and none in a job as it should be."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machining_centre.design import CentreDesign, LegScenario
from parapod.diagrams.machining_centre.machine import MACHINING_CENTRE
from parapod.diagrams.machining_centre.real import CentreGuard, CentreLimits
from parapod.diagrams.machining_centre.scenario import (
    CentreScenario,
    HolesScenario,
    WalkScenario,
)

PERIOD, LIMITS, ENDS = 0.01, CentreLimits(), ("min", "max")
NORMAL = {
    "legs.position": np.linspace(0.45, 0.5, 6),
    "length_error": np.full(6, 1e-4),
    "legs.current": np.full(6, -0.5),
    "status.age": np.array((0.004,)),
    "legs.emergency_stop": np.zeros(1),
}


def changed(name, index, value):
    array = NORMAL[name].copy()
    array[index] = value
    return {name: array}


def watch(ticks, changes, before=20, guard=None):
    """Ticks as they should be, and then others; each one's trip, with the time since then."""
    guard = guard or CentreGuard(CentreScenario())
    for k in range(before):
        assert guard.check(PERIOD * k, NORMAL) is None
    for k in range(ticks):
        trip = guard.check(PERIOD * (before + k), NORMAL | changes(k))
        if trip is not None:
            return PERIOD * k, trip
    return None


# Sign: what shows it, after how long, its words, and what is suspect.
SIGNS = {
    "emergency_stop": (changed("legs.emergency_stop", 0, 1.0), 0.0, "emergency stop", ()),
    "following_error": (
        *(changed("length_error", 3, -1.1 * LIMITS.following), LIMITS.persists),
        *("is more than 4 mm off its way", ("legs",)),
    ),
    "overload": (
        *(changed("legs.current", 4, -4.1), LIMITS.persists),
        *("pushes harder than it may", ()),
    ),
    "legs_stale": (
        *(changed("status.age", 0, 1.1 * LIMITS.oldest), LIMITS.persists),
        *("measurements that are old", ()),
    ),
}


@pytest.mark.parametrize(("name", "sign"), SIGNS.items(), ids=SIGNS)
def test_each_sign_ends_the_job_by_its_name_once_it_has_lasted(name, sign):
    changes, persists, words, distrusted = sign
    after, trip = watch(50, lambda k: changes)
    assert trip.name == name
    assert words in trip.sign
    assert trip.distrusted == distrusted
    assert after == pytest.approx(persists, abs=1.01 * PERIOD)
    assert trip.ends


@pytest.mark.parametrize("name", ["following_error", "overload", "legs_stale"])
def test_a_sign_that_passes_is_none(name):
    changes = SIGNS[name][0]
    assert watch(200, lambda k: changes if k % 10 < 9 else {}) is None


def test_what_is_just_normal_ends_nothing():
    most = (
        changed("length_error", 3, 0.99 * LIMITS.following)
        | changed("legs.current", 4, 3.99)
        | changed("status.age", 0, 0.99 * LIMITS.oldest)
        | changed("legs.emergency_stop", 0, 0.4)
    )
    assert watch(50, lambda k: most) is None


@pytest.mark.parametrize("name", ["length_error", "status.age"])
def test_what_is_no_number_ends_the_job(name):
    after, trip = watch(50, lambda k: changed(name, 0, np.nan))
    assert trip.name in ("following_error", "legs_stale")
    assert after <= LIMITS.persists + PERIOD


@pytest.mark.parametrize("size", [0.5, 2.0])
@pytest.mark.parametrize(("share", "ends"), [(0.99, False), (1.01, True)])
def test_legs_of_another_length_may_be_as_much_farther_off_their_way(size, share, ends):
    usual, scenario = CentreDesign(), CentreScenario()
    scenario.machine = replace(
        usual, **{f"stroke_{end}_mm": size * getattr(usual, f"stroke_{end}_mm") for end in ENDS}
    )
    off = changed("length_error", 3, share * size * LIMITS.following)
    assert (watch(50, lambda k: off, guard=CentreGuard(scenario)) is not None) is ends


def test_an_encoder_that_jumps_ends_the_job_at_once():
    def jump(by):
        return lambda k: changed("legs.position", 1, NORMAL["legs.position"][1] + by)

    fastest = 2.0 * 0.15 * PERIOD
    assert watch(5, jump(0.95 * fastest)) is None
    for by in (1.05 * fastest, -1.05 * fastest):
        after, trip = watch(5, jump(by))
        assert (trip.name, after, trip.distrusted) == ("encoder_jump", 0.0, ("legs",))
        assert (trip.sign, trip.axis) == ("changes faster than it can", ("legs", 1))


def test_a_jump_over_a_tick_that_is_late_is_none():
    guard = CentreGuard(CentreScenario())
    for k in range(5):
        guard.check(PERIOD * k, NORMAL)
    far = changed("legs.position", 1, 0.6)
    assert guard.check(5.7 * PERIOD, NORMAL | far) is None


def test_a_jump_is_judged_by_when_lengths_were_measured():
    # Measurements that are older than those before have had less time.
    guard = CentreGuard(CentreScenario())
    for k in range(5):
        guard.check(PERIOD * k, NORMAL | changed("status.age", 0, 0.02))
    by = 0.3 * (PERIOD + 0.018)
    fresh = changed("status.age", 0, 0.0) | {"legs.position": NORMAL["legs.position"] + by}
    assert guard.check(PERIOD * 5, NORMAL | fresh) is None


def test_a_loop_without_some_signals_is_watched_by_the_others():
    guard = CentreGuard(CentreScenario())
    assert guard.signals == set(NORMAL)
    for k in range(30):
        position = {"legs.position": NORMAL["legs.position"]}
        assert guard.check(PERIOD * k, position) is None


def test_a_job_as_it_should_be_has_no_sign():
    scenario = CentreScenario(
        backend="kinematic",
        begin=0.1,
        holes=HolesScenario(count=1, depth_mm=2.0),
        walk=WalkScenario(advance_mm=15.0, steps=1),
        machine=CentreDesign(legs=LegScenario(length_error_mm=0.2)),
    )
    view = replace(MACHINING_CENTRE.view, log_every=1)
    machine = replace(MACHINING_CENTRE, view=view)
    loop = ClosedLoop(machine, scenario, log=CentreGuard(scenario).signals)
    simulator = Simulator(loop)
    context = simulator.get_mutable_context()
    loop.reset(context)
    simulator.Initialize()
    simulator.AdvanceTo(9.0)
    run, guard = loop.recording(context), CentreGuard(scenario)
    assert set(run) == guard.signals
    assert np.ptp(run["legs.position"], axis=0).max() > 0.02
    for k, time in enumerate(run.time):
        assert guard.check(time, {name: samples[k] for name, samples in run.items()}) is None
