"""The rod that bends behind the platform's station: beginning, sag, wrench, on every backend."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.station import Station
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.carried_arm import CarriedArm

BACKENDS = ("kinematic", "multibody", "mujoco")
REDUCED = "plant={leg_model: reduced, time_step: 0.005}"
ROLL = math.radians(3.0)


class Platform:
    """A station whose platform stands, its arm led by hand."""

    def __init__(self, backend, *settings, arm="machine.arm=!FlexibleRod {}"):
        overrides = (f"backend={backend}", arm, REDUCED, "ground={roll_deg: 3, pitch_deg: 0}")
        self.scenario = load_scenario(LevellingScenario, overrides=(*overrides, *settings))
        self.station = Station(PLATFORM, self.scenario)
        self.simulator = Simulator(self.station)
        self.context = self.simulator.get_mutable_context()
        for port in PLATFORM.for_scenario(self.scenario).ports:
            if port.direction == "in":
                value = np.full(port.size, port.idle or 0.0)
                self.station.GetInputPort(port.name).FixValue(self.context, value)
        self.fix("legs.stop", [1.0])

    def fix(self, name, value):
        self.station.GetInputPort(name).FixValue(self.context, value)

    def lean(self, angle, duration=2.0):
        """Leans the arm slowly, and lets it rest."""
        steps = round(duration / self.scenario.control.period)
        for k in range(1, steps + 1):
            s = k / steps
            self.fix("arm.position_command", [0.0, angle * s**3 * (10 - 15 * s + 6 * s * s)])
            self.simulator.AdvanceTo(self.context.get_time() + duration / steps)
        return self

    def rest(self, seconds):
        self.simulator.AdvanceTo(self.context.get_time() + seconds)
        return self

    def __getitem__(self, name):
        return self.station.GetOutputPort(name).Eval(self.context)


@pytest.fixture(params=BACKENDS)
def backend(request):
    if request.param == "mujoco":
        pytest.importorskip("mujoco")
    return request.param


def test_it_begins_at_rest_and_bends_downhill(backend):
    platform = Platform(backend)
    rod = platform.scenario.machine.arm.bending
    across, along = GRAVITY * math.sin(ROLL), GRAVITY * math.cos(ROLL)
    # Rolled by 3 deg to the right: -y.
    expected = rod.sag(across, along, 1).across
    assert platform["truth.tip_deflection"][1] == pytest.approx(expected, rel=1e-6)
    platform.rest(0.5)
    # Bodies settle on their feet by some micrometres, which the rod amplifies.
    np.testing.assert_allclose(platform["truth.tip_deflection"][1], expected, atol=3e-4)


def test_leaning_rod_sags_and_loads_the_feet_by_it(backend):
    angle = math.radians(60.0)
    damped = "machine.arm.damping_ratio=0.2"
    bent = Platform(backend, damped).lean(angle).rest(3.0)
    rod, roll = bent.scenario.machine.arm.bending, bent["truth.posture"][0]
    up = (math.cos(roll) * math.sin(angle), math.sin(roll), math.cos(roll) * math.cos(angle))
    sags = [rod.sag(-GRAVITY * up[0], GRAVITY * up[2], 0), rod.sag(GRAVITY * up[1], up[2], 1)]
    assert bent["truth.tip_deflection"][0] == pytest.approx(sags[0].across, rel=5e-3)
    assert 40e-3 < bent["truth.tip_deflection"][0] < 55e-3
    # Beside a rigid rod of the same masses the weight is further out.
    stiff = ("machine.arm.bending_stiffness_Nm2=[1e5, 1e5]", "machine.arm.modes=1")
    rigid = Platform(backend, damped, *stiff).lean(angle).rest(3.0)
    shift = (bent["truth.contact_force"] - rigid["truth.contact_force"]) @ [-1, -1, 1, 1]
    moved = rod.tip_mass * sags[0].across * math.cos(angle) * GRAVITY
    lever = 0.74  # of the feet about the platform's centre [m]
    assert abs(shift) == pytest.approx(moved / lever, rel=0.25)


def test_a_stiff_rod_is_as_the_rigid_one(backend):
    angle = math.radians(30.0)
    stiff = ("machine.arm.bending_stiffness_Nm2=[1e5, 1e5]", "machine.arm.modes=1")
    flexible = Platform(backend, "machine.arm.damping_ratio=0.2", *stiff).lean(angle).rest(1.0)
    rigid = Platform(backend, arm="machine.arm=!Rod {}").lean(angle).rest(1.0)
    np.testing.assert_allclose(
        flexible["truth.contact_force"], rigid["truth.contact_force"], atol=0.5
    )
    np.testing.assert_allclose(
        flexible["truth.tip_pose"][4:], rigid["truth.tip_pose"][4:], atol=1e-3
    )


@pytest.mark.parametrize("arm", ["Rod", "FlexibleRod"])
def test_drives_give_way_alike_behind_every_backend(backend, arm):
    angle, stiffness = math.radians(50.0), 2000.0
    settings = (f"machine.arm.drives.stiffness_Nm_rad={stiffness}", "ground.roll_deg=0")
    damped = ("machine.arm.damping_ratio=0.2",) if arm == "FlexibleRod" else ()
    soft = Platform(backend, *settings, *damped, arm=f"machine.arm=!{arm} {{}}")
    tip = soft.lean(angle).rest(3.0)["truth.tip_pose"][4:]
    masses = soft.scenario.machine.masses
    carried = CarriedArm(
        soft.scenario.geometry_as_built, masses, soft.scenario.machine.arm.bending
    )
    posture, lean = soft["truth.posture"], (0.0, angle)
    # Bodies turn and slip a little.
    there = carried.tip_position(posture, lean)
    stiff = replace(carried, params=replace(masses, arm=masses.arm.stiff))
    stiff = stiff.tip_position(posture, lean)
    given_way = np.linalg.norm(there - stiff)
    lever = masses.arm.first_moment((0.0, angle))[0] * GRAVITY / stiffness
    assert given_way == pytest.approx(2.02 * lever, rel=0.05)
    assert np.linalg.norm(tip - there) < 0.12 * given_way


def test_a_reset_puts_the_rod_at_rest_again():
    platform = Platform("kinematic")
    begins = platform["truth.tip_deflection"].copy()
    platform.lean(0.5, duration=0.5)
    assert np.abs(platform["truth.tip_deflection"] - begins).max() > 5e-3
    context = platform.station.CreateDefaultContext()
    steeper = load_scenario(
        LevellingScenario,
        overrides=(
            *("backend=kinematic", "machine.arm=!FlexibleRod {}", REDUCED),
            "ground={roll_deg: 5, pitch_deg: 0}",
        ),
    )
    platform.station.reset(context, steeper)
    for port in PLATFORM.ports:
        if port.direction == "in":
            platform.station.GetInputPort(port.name).FixValue(context, np.zeros(port.size))
    there = platform.station.GetOutputPort("truth.tip_deflection").Eval(context)
    rod, roll = steeper.machine.arm.bending, math.radians(5.0)
    expected = rod.sag(GRAVITY * math.sin(roll), GRAVITY * math.cos(roll), 1).across
    assert there[1] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("machine.arm.modes=3", r"machine.arm.modes = 3: mode 3 .* 111 Hz.* at most 2 modes"),
        ("control.period=0.05", r"mode 1 of the rod|mode 2 of the rod"),
    ],
)
def test_modes_that_the_period_cannot_carry_are_refused_with_their_key(setting, words):
    with pytest.raises(ScenarioError, match=words) as refusal:
        Platform("kinematic", setting)
    assert refusal.value.key == "machine.arm.modes"


@pytest.mark.parametrize(
    ("settings", "period"),
    [
        (("plant.time_step=0.001",), 0.005),
        (("plant.time_step=0.002",), 0.004),
        (("plant.time_step=0.001", "machine.arm.modes=3"), 0.004),
    ],
)
def test_rod_on_bodies_takes_the_longest_steps_that_carry_its_modes(settings, period):
    platform = Platform("multibody", *settings)
    rod = platform.station.GetSubsystemByName("flexible_arm")
    ticks = rod.GetUniquePeriodicDiscreteUpdateAttribute()
    assert ticks.period_sec() == pytest.approx(period)
