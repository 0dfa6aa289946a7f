"""MuJoCo behind the stations: numbers as of Drake's plants, on slopes and on legs as built."""

import sys

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.station import Station
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.systems.core.errors import MissingExtra
from parapod.systems.core.scenario_file import load_scenario

pytest.importorskip("mujoco")
LEVELLING = (
    "machine.sensors.imu_noise=false",
    "ground.roll_deg=0",
    "ground.pitch_deg=5",
    "job.estimate_at=0.5",
    "plant.time_step=0.002",
)
WALKING = (
    "begin=0.2",
    "gait.phase_duration=1",
    "gait.lift_mm=10",
    "gait.step_mm=10",
    "gait.swing_height_mm=5",
    "plant.time_step=0.002",
)


def ran(machine, until, *settings):
    scenario = load_scenario(machine.scenario, None, None, settings)
    names = [port.name for port in machine.truth]
    loop = ClosedLoop(machine, scenario, log=names)
    simulator = Simulator(loop)
    simulator.AdvanceTo(until)
    return loop.recording(simulator.get_context())


def by_both(machine, until, *settings):
    return [ran(machine, until, f"backend={name}", *settings) for name in ("multibody", "mujoco")]


@pytest.mark.parametrize(
    "built",
    [
        (),
        ("plant.length_error_mm=1", "plant.angle_error_deg=0.2", "seed=2"),
        ("plant.leg_model=reduced", "ground.foot_heights_mm=[3,0,-2,1]"),
    ],
    ids=["drawn", "as built", "reduced, on pads"],
)
def test_the_platform_levels_itself_as_drakes_does(built):
    one, other = by_both(PLATFORM, 1.9, *LEVELLING, *built)
    late = one.time > 0.2
    difference = np.abs(other["truth.posture"] - one["truth.posture"])[late]
    assert np.degrees(difference[:, :2]).max() < 0.02
    assert difference[:, 2].max() < 3e-4
    moved = np.ptp(one["truth.posture"][late], axis=0)
    assert np.degrees(moved[1]) > 0.2, "nothing moves"
    weight = [run["truth.contact_force"][-1].sum() for run in (one, other)]
    assert weight[1] == pytest.approx(weight[0], rel=1e-3)
    # Loads hold the weight; how opposite legs share it is open.
    loads = [run["truth.load_force"][-1].sum() for run in (one, other)]
    assert loads[1] == pytest.approx(loads[0], rel=0.02)
    assert other["truth.loop_error"].max() < 1e-6


def test_the_platform_drives_on_its_wheels_as_drakes_does():
    settings = ("job.start=wheels", "plant.wheels=rolling", "plant.time_step=0.002")
    one, other = by_both(PLATFORM, 0.3, "machine.sensors.imu_noise=false", *settings)
    difference = np.abs(other["truth.posture"] - one["truth.posture"])[5:]
    assert difference.max() < 1e-4
    assert (other["truth.contact_force"] == 0.0).all()


def test_the_chair_steps_as_drakes_does():
    one, other = by_both(CHAIR, 3.0, *WALKING, "passenger.x_mm=40")
    late = one.time > 0.1
    apart = np.abs(other["truth.body_position"] - one["truth.body_position"])[late]
    assert apart.max() < 2e-4
    tilted = np.abs(other["truth.body_attitude"] - one["truth.body_attitude"])[late]
    assert np.degrees(tilted[:, :2]).max() < 0.02
    lifted = [run["truth.foot_height"].max() for run in (one, other)]
    assert lifted[1] == pytest.approx(lifted[0], abs=3e-4)
    assert lifted[0] > 3e-3, "nothing moves"
    stands = (one.time > 0.1) & (one.time < 0.2)
    for name in ("truth.force", "truth.contact_force"):
        np.testing.assert_allclose(other[name][stands], one[name][stands], atol=25.0)


def test_a_heavier_passenger_weighs_without_a_new_plant():
    scenario = load_scenario(
        CHAIR.scenario, None, None, ("backend=mujoco", "plant.time_step=0.002")
    )
    loop = ClosedLoop(CHAIR, scenario, log=())
    simulator = Simulator(loop)
    simulator.AdvanceTo(0.2)
    read = loop.readings(simulator.get_context(), ("truth.contact_force",))["truth.contact_force"]
    before = read().sum()
    scenario.passenger.mass_kg += 20.0
    plant = loop.station.behind.handle.plant
    plant.seat(simulator.get_mutable_context(), scenario.passenger.passenger)
    simulator.AdvanceTo(0.6)
    assert read().sum() - before == pytest.approx(20.0 * 9.81, rel=1e-3)


@pytest.mark.parametrize("machine", [PLATFORM, CHAIR], ids=lambda machine: machine.name)
def test_without_mujoco_only_its_backend_is_refused(machine, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    Station(machine, machine.scenario(backend="multibody"))
    with pytest.raises(MissingExtra, match=r'pip install "parapod\[mujoco\]"$') as refused:
        Station(machine, machine.scenario(backend="mujoco"))
    assert "\n" not in str(refused.value)
