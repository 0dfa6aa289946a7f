"""What the platform's controller knows of its machine, key by key: each one acts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.controller import make_supervised_controller
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.diagrams.levelling_platform.parts import ActuatorScenario, SensorScenario
from parapod.diagrams.levelling_platform.real import PlatformGuard
from parapod.diagrams.levelling_platform.scenario import (
    ArmScenario,
    ControlScenario,
    GroundScenario,
    JobScenario,
    LegDeviationScenario,
    LevellingScenario,
    PlantScenario,
)
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.physics import STANDARD_GRAVITY
from parapod.systems.levelling_platform.kinematics import forward_kinematics

IDEAL = SensorScenario(0.0, False, 0.0, 0.0)
SECONDS = 9.0


def scenario(**parts):
    given = {
        "backend": "kinematic",
        "ground": GroundScenario(1.0, -1.5),
        "machine": PlatformDesign(sensors=IDEAL),
        "job": JobScenario(estimate_at=1.0, waypoints=[], arm=ArmScenario(angle_deg=0.0)),
    }
    return LevellingScenario(**(given | parts))


def simulated(case, *names):
    loop = ClosedLoop(PLATFORM, case, log=names)
    simulator = Simulator(loop)
    simulator.AdvanceTo(SECONDS)
    return loop.recording(simulator.get_context())


def posture_error(case):
    """Roll, pitch [deg] and height [mm] off the level posture at the end."""
    end = simulated(case, "truth.posture")["truth.posture"][-1]
    return np.abs(end - [0.0, 0.0, case.level_height]) * [*np.degrees([1, 1]), 1e3]


def known_legs(geometry):
    """A machine's legs by the keys of the scenario; l_x, l_y, l_z answer for l_6 and l_7."""
    legs = []
    for built, drawn in zip(geometry.legs, DRAWN.legs, strict=True):
        other = replace(built, l_6=drawn.l_6, l_7=drawn.l_7)
        # Where the hip has to be for the foot to be where it is.
        shift = np.subtract(built.p_MF, other.p_MF)
        legs.append(
            LegDeviationScenario(
                l_x_mm=1e3 * (built.l_x + shift[0] - drawn.l_x),
                l_y_mm=1e3 * (built.l_y + shift[1] - drawn.l_y),
                l_z_mm=1e3 * (built.l_z + shift[2] - drawn.l_z),
                beta_deg=math.degrees(built.beta - drawn.beta),
                l_3_mm=1e3 * (built.l_3 - drawn.l_3),
                l_4_mm=1e3 * (built.l_4 - drawn.l_4),
                alpha_deg=math.degrees(built.alpha - drawn.alpha),
            )
        )
    return legs


def test_a_controller_that_knows_nothing_is_that_of_the_drawing():
    case = LevellingScenario()
    control = case.control
    assert case.geometry_as_known == DRAWN
    assert case.gain_share == (1.0,) * 4
    assert not control.encoder_offsets.any()
    assert not control.inclination_bias.any()


def test_known_legs_have_the_feet_where_they_are():
    case = scenario(plant=PlantScenario(length_error_mm=2.0, angle_error_deg=0.5))
    built = case.geometry_as_built
    known = scenario(control=ControlScenario(leg_deviations=known_legs(built))).geometry_as_known
    extension = np.array([0.400, 0.410, 0.405, 0.402])
    postures = [forward_kinematics(g, extension, (0.0, 0.0)) for g in (built, known)]
    np.testing.assert_allclose(*postures, atol=1e-12)


def test_known_legs_take_the_platform_to_the_posture_that_is_asked_for():
    plant = PlantScenario(length_error_mm=2.0, angle_error_deg=0.5)
    case = scenario(plant=plant)
    legs = known_legs(case.geometry_as_built)
    by_drawing = posture_error(case)
    as_known = posture_error(scenario(plant=plant, control=ControlScenario(leg_deviations=legs)))
    assert by_drawing[2] > 0.5
    assert as_known[2] < 0.1 * by_drawing[2]


def test_deviations_of_some_legs_only_are_refused():
    control = ControlScenario(leg_deviations=[LegDeviationScenario()])
    with pytest.raises(ScenarioError, match=r"leg_deviations must have 4 elements or none, not 1"):
        _ = scenario(control=control).geometry_as_known


def test_encoder_offsets_are_added_to_what_encoders_tell():
    # The simulated encoders have none: what is added makes the legs shorter by as much.
    offsets = [1.0, 1.0, 1.0, 1.0]
    names = ("truth.posture", "truth.extension", "extension_desired_state")
    plain = simulated(scenario(), *names)
    offset = simulated(scenario(control=ControlScenario(encoder_offsets_mm=offsets)), *names)
    moved = offset["truth.extension"][-1] - plain["truth.extension"][-1]
    np.testing.assert_allclose(moved, -1e-3, atol=2e-5)
    followed = offset["extension_desired_state"][-1, :4] - offset["truth.extension"][-1]
    np.testing.assert_allclose(followed, 1e-3, atol=2e-5)


def test_the_sensor_s_bias_is_taken_off_roll_and_pitch():
    biased = replace(IDEAL, accel_bias_mg=5.0)
    names = ("attitude_estimated", "truth.posture")
    plain = simulated(scenario(machine=PlatformDesign(sensors=biased)), *names)
    error = np.degrees(plain["attitude_estimated"][-1] - plain["truth.posture"][-1, :2])
    assert np.abs(error).min() > 0.2  # 5 mg are .29 deg
    control = ControlScenario(inclination_bias_deg=error.tolist())
    known = posture_error(scenario(machine=PlatformDesign(sensors=biased), control=control))
    assert posture_error(scenario(machine=PlatformDesign(sensors=biased)))[:2].min() > 0.2
    assert known[:2].max() < 0.03


def test_known_gains_make_legs_follow_whose_gains_differ():
    def errors(**known):
        # Slow loops, which leave more to the feedforward.
        control = ControlScenario(pole=2.0, **known)
        machine = PlatformDesign(actuators=ActuatorScenario(gain_error=0.3), sensors=IDEAL)
        case = scenario(control=control, machine=machine)
        names = ("extension_desired_state", "truth.extension")
        signals = simulated(case, *names)
        moving = (signals.time > 1.2) & (signals.time < 4.0)
        desired = signals["extension_desired_state"][moving, :4]
        return 1e3 * np.abs(signals["truth.extension"][moving] - desired).max(axis=0)

    share = 1.0 + np.random.default_rng(0).uniform(-0.3, 0.3, 4)
    known = errors(actuator_gains=(0.01 * share).tolist())
    assert known.max() < 0.5 * errors().max()


def test_the_supervised_controller_is_built_with_what_is_known():
    legs = [LegDeviationScenario(l_4_mm=1.0)] * 4
    control = ControlScenario(
        leg_deviations=legs,
        encoder_offsets_mm=[0.1] * 4,
        inclination_bias_deg=[0.1, 0.1],
        actuator_gains=[0.011] * 4,
    )
    controller = make_supervised_controller(scenario(control=control))
    detector = controller.GetSubsystemByName("fault_detector")
    assert detector.geometry == scenario(control=control).geometry_as_known
    names = [system.get_name() for system in controller.GetSystems()]
    assert {"encoder_correction", "inclination_correction"} <= set(names)


def test_the_guard_judges_corrected_extensions():
    values = {
        "legs.extension": np.full(4, 0.380),
        "legs.limits": np.zeros(12),
        "legs.voltage": np.zeros(4),
        "imu.gyro": np.zeros(3),
        "imu.accel": np.array([0.0, 0.0, STANDARD_GRAVITY]),
        "status.age": np.zeros(4),
    }
    assert PlatformGuard(scenario()).check(0.0, values) is None
    far = ControlScenario(encoder_offsets_mm=[-10.0] * 4)
    trip = PlatformGuard(scenario(control=far)).check(0.0, values)
    assert trip is not None
    assert trip.name == "encoder_invalid"


def test_an_instrument_reads_what_the_tracker_of_the_paper_resolves():
    posture = np.array([*np.radians([1.234, -0.567]), 0.45512])
    told = PLATFORM.real.instrument({"truth.posture": posture})
    assert told == "height 455.10 mm, roll 1.23 deg, pitch -0.57 deg"
