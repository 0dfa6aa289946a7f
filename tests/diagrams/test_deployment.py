"""A platform that drives to its place, stands up, works and leaves."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.controller import make_supervised_controller
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import (
    GroundScenario,
    JobScenario,
    LevellingScenario,
    PlatformFault,
)
from parapod.systems.levelling_platform.scripts import OperatorScript, Step
from parapod.systems.levelling_platform.stability_monitor import StabilityMonitorParams
from parapod.systems.levelling_platform.supervisor import Command, Phase, Refusal
from parapod.systems.levelling_platform.wheels import WHEEL_DRIVE, WheelGeometry

PERIOD = 0.01
FOOT_HEIGHTS = (20.0, 0.0, 12.0, 5.0)  # [mm]
HEIGHT = 0.477
SPEED, WAY = 0.3, 0.45
SWING = math.radians(45.0)
SIGNALS = (
    *("arm.position_command", "arm_refused", "arm_request", "extension_desired_state"),
    *("foot_offsets_estimated", "legs.extension", "legs.limits", "legs.voltage", "phase"),
    *("refusal", "stability_margin", "steps_done", "wheels.brake", "wheels.velocity"),
    *("wheels.velocity_command", "truth.contact_force", "truth.foot_height", "truth.posture"),
)
ORDER = ["TRANSPORT", "BRAKE", "LOWER", "TOUCHDOWN", "ESTIMATE", "POSTURE", "HOLD"]


def run(steps, start, seconds):
    """Records a deployment until its steps are done, at most some seconds."""
    scenario = LevellingScenario(
        backend="kinematic",
        ground=GroundScenario(2.0, 3.0, list(FOOT_HEIGHTS)),
        job=JobScenario(start="wheels", start_x_m=start),
    )
    loop = ClosedLoop(
        PLATFORM,
        scenario,
        controller=make_supervised_controller(scenario),
        sources=[OperatorScript(steps, (0.0, 0.0, HEIGHT), PERIOD)],
        log=SIGNALS,
    )
    simulator = Simulator(loop)
    context = simulator.get_context()
    while context.get_time() < seconds:
        simulator.AdvanceTo(context.get_time() + 2.0)
        signals = loop.recording(context)
        if signals["steps_done"][-1, 0] == len(steps):
            break
    phases = [Phase(int(p)) for p in signals["phase"][:, 0]]
    return SimpleNamespace(time=signals.time, signals=signals, phases=np.array(phases))


@pytest.fixture(scope="module")
def deployment():
    """Everything once; the arm is asked for at wrong times, and another posture is not reached."""
    steps = [
        Step(Phase.TRANSPORT, 0.1, arm=(0.0, SWING)),
        Step(Phase.TRANSPORT, 0.2, arm=(0.0, 0.0)),
        Step(Phase.TRANSPORT, 0.5, drive=(SPEED, 0.0)),
        Step(Phase.TRANSPORT, WAY / SPEED, drive=(0.0, 0.0)),
        Step(Phase.TRANSPORT, 1.0, Command.GO),
        Step(Phase.ESTIMATE, 0.5, arm=(0.5, SWING)),
        Step(Phase.ESTIMATE, 1.0, arm=(0.0, 0.0)),
        Step(Phase.HOLD, 1.5, arm=(0.0, SWING)),
        Step(Phase.HOLD, 2.5, arm=(0.0, 0.0)),
        Step(Phase.HOLD, 2.5, posture=(0.02, -0.02, HEIGHT)),
        Step(Phase.POSTURE, 1.0, Command.STOP),
        Step(Phase.TRANSPORT, 0.5, drive=(SPEED, 0.0)),
        Step(Phase.TRANSPORT, 1.0, drive=(0.0, 0.0)),
    ]
    return run(steps, -WAY, 80.0)


def order_of(deployment):
    phases = deployment.phases
    changes = np.flatnonzero(np.diff(phases)) + 1
    return [Phase(phases[0]).name, *(Phase(phases[i]).name for i in changes)]


def during(deployment, phase, name):
    """Samples of a signal in a phase."""
    return deployment.signals[name][deployment.phases == phase]


def wheel_clearance(posture, ground):
    """Height of the lowest wheel above the ground [m]."""
    wheels, n = WheelGeometry(), RollPitchYaw(*ground, 0.0).ToRotationMatrix().matrix()[:, 2]
    g = RollPitchYaw(posture[0], posture[1], 0.0).ToRotationMatrix().matrix().T @ n
    return posture[2] + min(np.array(wheels.axles) @ g) - wheels.radius


# The whole way


def test_phases_follow_each_other_and_lead_back_to_transport(deployment):
    assert order_of(deployment) == [*ORDER, "POSTURE", "RETRACT", "TRANSPORT"]
    assert deployment.signals["refusal"][-1].tolist() == [float(Refusal.NONE), 0.0]


def test_neither_desired_extensions_nor_voltages_jump(deployment):
    params = PlatformDesign().supervisor
    fastest = max(params.raising_rate, params.lowering_rate)
    desired = deployment.signals["extension_desired_state"][:, :4]
    assert np.abs(np.diff(desired, axis=0)).max() <= 1.1 * fastest * PERIOD
    voltage = deployment.signals["legs.voltage"]
    assert np.abs(np.diff(voltage, axis=0)).max() < 0.5
    assert np.abs(voltage).max() < 2.0


def test_at_each_transition_desired_extensions_go_on_as_before(deployment):
    """The end of a phase and the beginning of the next one differ by encoder counts."""
    desired = deployment.signals["extension_desired_state"]
    for i in np.flatnonzero(np.diff(deployment.phases)) + 1:
        expected = desired[i - 1, :4] + PERIOD * desired[i - 1, 4:]
        np.testing.assert_allclose(desired[i, :4], expected, rtol=0, atol=2e-5)


def test_wheels_accelerate_within_their_limit(deployment):
    params = WHEEL_DRIVE
    velocity = deployment.signals["wheels.velocity"]
    step = params.acceleration * PERIOD + params.resolution / PERIOD
    assert 0.0 < np.abs(np.diff(velocity, axis=0)).max() <= step
    assert velocity.max() == pytest.approx(SPEED / WheelGeometry().radius, rel=0.02)


def test_the_arm_is_told_to_move_within_its_limits(deployment):
    params = StabilityMonitorParams()
    command = deployment.signals["arm.position_command"]
    rates = np.diff(command, axis=0) / PERIOD
    assert (np.abs(rates).max(axis=0) <= np.array(params.rate) * 1.001).all()
    accelerations = np.diff(rates, axis=0) / PERIOD
    assert (np.abs(accelerations).max(axis=0) <= np.array(params.acceleration) * 1.001).all()
    assert command[:, 1].max() == pytest.approx(SWING, abs=1e-6)


# Wheels and brakes


def test_the_platform_drives_in_transport_only(deployment):
    driving = deployment.phases == Phase.TRANSPORT
    assert not deployment.signals["wheels.velocity_command"][~driving].any()
    np.testing.assert_array_equal(deployment.signals["wheels.brake"][:, 0], ~driving)
    assert not deployment.signals["wheels.velocity"][deployment.phases >= Phase.LOWER].any()


def test_all_legs_are_up_while_it_drives(deployment):
    params = PlatformDesign().supervisor
    up = during(deployment, Phase.TRANSPORT, "legs.extension")
    assert up.min() >= params.raised - params.arrived - 1e-5
    assert during(deployment, Phase.TRANSPORT, "truth.foot_height").min() > 0.1


# Touchdown


def test_feet_find_the_ground_in_the_order_of_their_heights(deployment):
    contact = deployment.signals["legs.limits"][:, 8:] > 0.5
    first = deployment.time[contact.argmax(axis=0)]
    assert np.argsort(first).tolist() == np.argsort(FOOT_HEIGHTS)[::-1].tolist()
    assert (np.diff(np.sort(first)) > 0.1).all()


def test_legs_are_back_where_they_touched_before_the_ground_is_estimated(deployment):
    contact = deployment.signals["legs.limits"][:, 8:] > 0.5
    extension = deployment.signals["legs.extension"]
    touched = extension[contact.argmax(axis=0), range(4)]
    down = during(deployment, Phase.TOUCHDOWN, "legs.extension")
    np.testing.assert_allclose(down, np.tile(touched, (len(down), 1)), rtol=0, atol=1.2e-4)


def test_wheels_carry_until_the_posture_is_taken(deployment):
    for phase in (Phase.LOWER, Phase.TOUCHDOWN, Phase.ESTIMATE):
        posture = during(deployment, phase, "truth.posture")
        assert np.abs(np.degrees(posture[:, :2]) - (2.0, 3.0)).max() < 0.05
        assert np.abs(posture[:, 2] - WheelGeometry().standing_height).max() < 5e-4


def test_the_estimated_ground_is_that_under_the_feet(deployment):
    estimated = during(deployment, Phase.HOLD, "foot_offsets_estimated")[0]
    # Of four feet one combination of heights is not a plane.
    pattern = np.array((1.0, -1.0, 1.0, -1.0))
    expected = pattern * (pattern @ FOOT_HEIGHTS) / 4e3
    np.testing.assert_allclose(estimated, expected, rtol=0, atol=5e-4)


# Work


def test_the_posture_is_held_within_its_bounds_while_the_arm_swings(deployment):
    posture = during(deployment, Phase.HOLD, "truth.posture")
    assert len(posture) > 600
    assert np.abs(np.degrees(posture[:, :2])).max() < 0.2
    expected = HEIGHT + 1e-3 * np.mean(FOOT_HEIGHTS)
    assert np.abs(posture[:, 2] - expected).max() < 2e-3
    # All four feet stand, wheels are clear, and the platform is far from tipping.
    assert during(deployment, Phase.HOLD, "legs.limits")[:, 8:].min() == 1.0
    assert during(deployment, Phase.HOLD, "truth.contact_force").min() > 5.0
    assert min(wheel_clearance(p, np.radians((2.0, 3.0))) for p in posture[::20]) > 0.02
    assert during(deployment, Phase.HOLD, "stability_margin").min() > 0.3


def test_the_arm_is_refused_while_the_platform_is_not_held(deployment):
    asked = deployment.signals["arm_request"].any(axis=1)
    held = deployment.phases == Phase.HOLD
    wrong = asked & ~held
    assert {Phase(deployment.phases[i]).name for i in np.flatnonzero(wrong)} == {
        "TRANSPORT",
        "ESTIMATE",
    }
    assert not deployment.signals["arm.position_command"][~held].any()
    in_transport = wrong & (deployment.phases == Phase.TRANSPORT)
    # It is judged a period later.
    assert deployment.signals["arm_refused"][np.flatnonzero(in_transport)[1:]].all()


def test_a_platform_that_is_stopped_while_it_is_lowered_goes_back_without_a_jump():
    go, stop = Step(Phase.TRANSPORT, 0.1, Command.GO), Step(Phase.LOWER, 3.0, Command.STOP)
    stopped = run([go, stop, Step(Phase.TRANSPORT, 0.5)], 0.0, 30.0)
    assert order_of(stopped) == ["TRANSPORT", "BRAKE", "LOWER", "RETRACT", "TRANSPORT"]
    desired = stopped.signals["extension_desired_state"][:, :4]
    fastest = PlatformDesign().supervisor.raising_rate
    assert np.abs(np.diff(desired, axis=0)).max() <= 1.1 * fastest * PERIOD
    assert np.abs(np.diff(stopped.signals["legs.voltage"], axis=0)).max() < 0.5


# Emergency stop


def test_after_an_emergency_stop_nothing_moves_until_it_is_reset_and_begun_again():
    pressed, released, reset, begun = 8.0, 11.0, 14.0, 17.0
    scenario = LevellingScenario(
        backend="kinematic",
        job=JobScenario(start="wheels"),
        faults=[
            PlatformFault(
                at=pressed, target="legs.emergency_stop", kind="wrong", duration=released - pressed
            )
        ],
    )
    steps = (
        Step(Phase.TRANSPORT, 1.0, Command.GO),
        # In vain while the button is down.
        Step(Phase.FAULT, 1.0, Command.RESET),
        Step(Phase.FAULT, 1.0, Command.GO),
        Step(Phase.FAULT, reset - pressed - 2.0, Command.RESET),
        Step(Phase.STANDBY, begun - reset, Command.STOP),
        Step(Phase.RETRACT, 1.0),
    )
    loop = ClosedLoop(
        PLATFORM,
        scenario,
        controller=make_supervised_controller(scenario),
        sources=[OperatorScript(steps, (0.0, 0.0, HEIGHT), PERIOD)],
    )
    simulator = Simulator(loop)
    simulator.AdvanceTo(begun + 3.0)
    signals = loop.recording(simulator.get_context())
    time, phase = signals.time, signals["phase"][:, 0]
    before = (time > pressed - 0.2) & (time < pressed)
    assert (phase[before] == Phase.LOWER).all()  # it moves
    assert np.abs(signals["legs.voltage"][before]).min() > 0.1
    after = (time >= pressed + 0.03) & (time < begun)
    assert set(phase[after & (time < reset)]) == {Phase.FAULT}
    assert set(phase[after & (time > reset + 0.1)]) == {Phase.STANDBY}
    cut = after & (time < reset)
    assert not signals["legs.voltage"][cut].any()
    assert (signals["legs.stop"][cut] == 1.0).all()
    assert not signals["wheels.velocity_command"][after].any()
    # Controlled again after the reset, where it has come to stand.
    stood = signals["truth.extension"][after & (time > pressed + 0.3)]
    assert np.ptp(stood, axis=0).max() < 2e-5
    assert np.abs(signals["legs.voltage"][after]).max() < 0.3
    assert (phase[time > begun + 0.5] == Phase.RETRACT).all()
    assert (signals["legs.extension"][-1] > stood[-1] + 1e-3).all()
