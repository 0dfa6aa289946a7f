"""Disturbances behind the station's ports: alike on every backend, or refused."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.disturbances import Push
from parapod.diagrams.levelling_platform.disturbances import Subsidence
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.station import Station
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.scenario_file import load_scenario

BACKENDS = ("kinematic", "multibody", "mujoco")
LEVEL = "ground={roll_deg: 0, pitch_deg: 0}"
REDUCED = "plant={leg_model: reduced, time_step: 0.005}"


@pytest.fixture(params=BACKENDS)
def backend(request):
    if request.param == "mujoco":
        pytest.importorskip("mujoco")
    return request.param


def scenario_of(*settings):
    return load_scenario(LevellingScenario, overrides=(LEVEL, REDUCED, *settings))


@pytest.fixture
def after(backend):
    """after(time, disturbances, *settings): what a platform at rest shows then."""

    def shown(time, disturbances, *settings):
        scenario = scenario_of(f"backend={backend}", f"disturbances={disturbances}", *settings)
        station = Station(PLATFORM, scenario)
        simulator = Simulator(station)
        context = simulator.get_mutable_context()
        for port in PLATFORM.for_scenario(scenario).ports:
            if port.direction == "in":
                value = np.full(port.size, port.idle or 0.0)
                station.GetInputPort(port.name).FixValue(context, value)
        station.GetInputPort("legs.stop").FixValue(context, [1.0])
        simulator.AdvanceTo(time)
        names = ("posture", "contact_force", "foot_height")
        return {n: station.GetOutputPort(f"truth.{n}").Eval(context) for n in names}

    return shown


def test_the_ground_bears_a_push_downwards_and_a_payload(after):
    push = "!Push {at: 0.5, duration: 0.4, force_N: [0, 0, -60], place_mm: [50, 0, 0]}"
    payload = "!Payload {at: 0.2, duration: 0.1, mass_kg: 0.8}"
    before, at_the_peak, later = (
        after(time, f"[{push}, {payload}]")["contact_force"].sum() for time in (0.15, 0.7, 1.4)
    )
    assert later - before == pytest.approx(0.8 * GRAVITY, rel=2e-3)
    # Springs and masses of bodies follow the push as it rises.
    assert at_the_peak - later == pytest.approx(60.0, rel=0.03)


def test_a_moment_shifts_the_load_from_one_side_to_the_other(after):
    turn = "!Push {at: 0.2, duration: 1.0, force_N: [0, 0, 0], moment_Nm: [8, 0, 0]}"
    at_rest, turned = (after(0.7, f"[{each}]" if each else "[]") for each in ("", turn))
    change = turned["contact_force"] - at_rest["contact_force"]
    left, right = change[[0, 3]], change[[1, 2]]
    assert max(left) < 0.0 < min(right)
    assert change.sum() == pytest.approx(0.0, abs=0.5)


def test_a_foot_hangs_where_its_ground_gives_way(after):
    # The weight stays over the other three.
    arm = "machine.arm=!Rod {base_mm: [-200, 0, 145], link: {mass_kg: 15}}"
    subsidence = "[!Subsidence {at: 0.2, duration: 0.3, foot: 4, depth_mm: 10}]"
    before, later = (after(time, subsidence, arm) for time in (0.15, 2.0))
    np.testing.assert_allclose(before["foot_height"], 0.0, atol=2e-4)
    np.testing.assert_allclose(later["foot_height"], [0.0, 0.0, 0.0, 0.01], atol=3e-4)
    np.testing.assert_allclose(later["posture"], before["posture"], atol=1e-3)
    assert later["contact_force"][3] == pytest.approx(0.0, abs=1e-6)


def test_a_platform_follows_ground_that_gives_way_under_its_weight(after):
    arm = "machine.arm=!Rod {base_mm: [200, 0, 145], link: {mass_kg: 15}}"
    subsidence = "[!Subsidence {at: 0.2, duration: 0.3, foot: 4, depth_mm: 10}]"
    before, later = (after(time, subsidence, arm) for time in (0.15, 2.0))
    assert later["contact_force"][3] > 20.0
    # It turns about the diagonal of the others, towards the fourth leg, at the front on the left.
    roll, pitch, height = later["posture"] - before["posture"]
    assert roll < -1e-3
    assert pitch > 1e-3
    assert height == pytest.approx(0.0, abs=3e-4)
    np.testing.assert_allclose(later["foot_height"], [0.0, 0.01, 0.0, 0.0], atol=6e-4)


def test_two_subsidences_of_one_foot_are_one_of_both_depths(after):
    one = "!Subsidence {at: 0.2, duration: 0.2, foot: 4, depth_mm: 10}"
    parts = "!Subsidence {at: 0.2, duration: 0.2, foot: 4, depth_mm: 4}, "
    parts += "!Subsidence {at: 0.3, duration: 0.1, foot: 4, depth_mm: 6}"
    arm = "machine.arm=!Rod {base_mm: [-200, 0, 145], link: {mass_kg: 15}}"
    ends = [after(1.0, f"[{each}]", arm)["foot_height"] for each in (one, parts)]
    np.testing.assert_allclose(*ends, atol=2e-5)


def test_ground_that_rises_lifts_its_foot(after):
    arm = "machine.arm=!Rod {base_mm: [200, 0, 145], link: {mass_kg: 15}}"
    rise = "[!Subsidence {at: 0.2, duration: 0.3, foot: 4, depth_mm: -6}]"
    before, later = (after(time, rise, arm) for time in (0.15, 2.0))
    # It turns about the line of the feet at the front, and the hind one on that side hangs.
    roll, pitch, _ = later["posture"] - before["posture"]
    assert roll > 3e-3
    assert pitch == pytest.approx(0.0, abs=3e-4)
    np.testing.assert_allclose(later["foot_height"], [0.006, 0.0, 0.0, 0.0], atol=6e-4)


def test_ground_that_will_give_way_bears_the_wheels_as_it_is(after):
    wheels = "job.start=wheels", "plant.wheels=rolling"
    postures = [
        after(1.0, disturbances, *wheels)["posture"]
        for disturbances in ("[]", "[!Subsidence {at: 5, foot: 4, depth_mm: 10}]")
    ]
    np.testing.assert_allclose(*postures, atol=2e-4)


def test_uneven_ground_may_give_way_too(after):
    uneven = "ground.foot_heights_mm=[0, 3, 0, 0]"
    arm = "machine.arm=!Rod {base_mm: [-200, 0, 145], link: {mass_kg: 15}}"
    later = after(1.5, "[!Subsidence {at: 0.2, foot: 4, depth_mm: 8}]", uneven, arm)
    np.testing.assert_allclose(later["foot_height"], [0.0, 0.0, 0.0, 0.008], atol=5e-4)


def test_a_course_begins_and_ends_where_it_should():
    push = Push(at=1.0, duration=0.5).pulse([4.0, -2.0])
    for time, share in ((0.0, 0.0), (1.0, 0.0), (1.25, 1.0), (1.5, 0.0), (9e6, 0.0)):
        np.testing.assert_allclose(push.value(time)[:, 0], [4.0 * share, -2.0 * share])
    step = Subsidence(at=0.0, duration=0.5).step([3.0])
    for time, value in ((0.0, 0.0), (0.25, 1.5), (0.5, 3.0), (9e6, 3.0)):
        assert step.value(time)[0, 0] == pytest.approx(value, abs=1e-12)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            ("backend=mock", "disturbances=[!Push {}]"),
            "disturbances must be empty with the backend 'mock': they act with multibody, "
            "kinematic or mujoco",
        ),
        (
            ("machine.arm=!None {}", "disturbances=[!Payload {}]"),
            "disturbances.0: a platform without an arm takes no payload",
        ),
        (
            ("disturbances=[!Payload {}, !Payload {at: 20}]",),
            "disturbances.1: the tip takes one payload, not 2",
        ),
    ],
)
def test_disturbances_that_do_not_fit_are_refused(settings, message):
    scenario = scenario_of(*settings)
    with pytest.raises(ScenarioError) as refusal:
        PLATFORM.for_scenario(scenario)
    assert str(refusal.value) == message


def test_a_payload_under_which_the_rod_buckles_is_refused():
    arm = "machine.arm=!FlexibleRod {}"
    scenario = scenario_of(arm, "disturbances=[!Payload {mass_kg: 500}]")
    with pytest.raises(ScenarioError, match=r"^disturbances: with a payload of 500 kg, .*buckles"):
        Station(PLATFORM, scenario)


def test_a_foot_that_the_platform_does_not_have_is_refused():
    scenario = scenario_of("disturbances=[!Subsidence {foot: 5}]")
    with pytest.raises(ScenarioError, match=r"^disturbances\.0\.foot = 5: .* feet 1 to 4$"):
        Station(PLATFORM, scenario)
