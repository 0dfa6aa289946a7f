"""Laws of physics that rigid bodies obey on every machine, whatever it is made of."""

from functools import cache
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import Simulator

from parapod.diagrams.machine import find_machine, list_machines
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import leaf_systems, outputs_of
from parapod.systems.core.errors import WiringError
from parapod.systems.core.scenario_file import load_scenario


class Drives(NamedTuple):
    """Drives of a machine that move its bodies.

    Attributes:
        force: signal of their forces.
        position: signal of their positions.
        command: that moves them; a position follows from the rate.
        rate: velocity, or what else is commanded.
        released: switches that are off meanwhile.
        lost: part of the work that becomes neither height nor speed [-]: friction, and what the
            chair's legs, whose feet stick, strain each other.
    """

    force: str
    position: str
    command: str
    rate: Any
    released: tuple[str, ...]
    lost: float


DRIVES = {
    "levelling_platform": Drives(
        *("truth.load_force", "truth.extension", "legs.voltage", 6.0),
        *(("legs.stop", "wheels.brake"), 2e-3),
    ),
    "walking_chair": Drives(
        *("truth.force", "truth.position", "legs.velocity_command", 0.01, ("legs.brake",), 0.15),
    ),
    "machining_centre": Drives(
        *("truth.leg_force", "legs.position", "legs.position_command", 0.01),
        *(("legs.brake",), 1e-4),
    ),
    "any_mechanism": Drives(
        *("truth.motor_force", "motors.position", "motors.position_command", 0.01),
        *(("motors.brake",), 0.01),
    ),
    "terrain_simulator": Drives(
        *("truth.slider_force", "sliders.position", "sliders.position_command"),
        *(np.array([0.01, -0.01, -0.01]), ("sliders.brake",), 0.01),
    ),
}
POSES = {f"truth.{name}" for name in ("posture", "body_position", "body_attitude", "pose")}
STOOD, MOVED, OVER = 0.3, 0.75, 0.95  # [s]
OWN = [m for m in list_machines() if find_spec(f"parapod.diagrams.{m.name}")]
ON_FEET = [m for m in OWN if "truth.contact_force" in {port.name for port in m.truth}]
each_machine = pytest.mark.parametrize("name", [machine.name for machine in OWN])
each_on_feet = pytest.mark.parametrize("name", [machine.name for machine in ON_FEET])


class Run:
    """Rigid bodies that first stand, and then are moved by their drives.

    Attributes:
        weight: of what moves [N].
        time: after each period of the controller (N,) [s].
        energy: of the bodies, of their heights and speeds (N,) [J].
        positions: of all joints (N, size) [m, rad].
        signals: what the station shows (N, size), by name.
    """

    def __init__(self, name, time_step, accuracy="null"):
        machine = find_machine(name)
        steps = f"plant={{time_step: {time_step}, accuracy: {accuracy}}}"
        overrides = ["backend=multibody", steps]
        station = Station(machine, load_scenario(machine.scenario, None, None, overrides))
        (plant,) = [s for s in leaf_systems(station) if isinstance(s, MultibodyPlant)]
        simulator = station.simulator()
        root = simulator.get_mutable_context()
        station.reset(root)
        context = plant.GetMyContextFromRoot(root)
        shown = outputs_of(station)
        drives = DRIVES[name]
        for port in machine.inputs:
            value = 0.0 if port.name in drives.released else port.idle
            station.GetInputPort(port.name).FixValue(root, np.full(port.size, value))
        command = station.GetInputPort(drives.command)
        period = station.scenario.control.period
        place = shown[drives.position].Eval(root).copy()
        times, energies, rows = [], [], {name: [] for name in shown}
        positions = []
        for k in range(round(OVER / period)):
            speed = drives.rate * np.clip((k * period - STOOD) / 0.1, 0.0, 1.0)
            place += speed * period
            value = place if drives.command.endswith("position_command") else speed
            command.FixValue(root, np.broadcast_to(value, command.size()))
            simulator.AdvanceTo((k + 1) * period)
            times.append(root.get_time())
            positions.append(plant.GetPositions(context).copy())
            energies.append(plant.CalcPotentialEnergy(context) + plant.CalcKineticEnergy(context))
            for name, port in shown.items():
                rows[name].append(port.Eval(root).copy())
        anchored = {body.index() for body in plant.GetBodiesWeldedTo(plant.world_body())}
        bodies = [plant.get_body(BodyIndex(i)) for i in range(1, plant.num_bodies())]
        mass = sum(b.get_mass(context) for b in bodies if b.index() not in anchored)
        self.weight = -mass * plant.gravity_field().gravity_vector()[2]
        self.time, self.energy = np.array(times), np.array(energies)
        self.positions = np.array(positions)
        self.signals = {name: np.array(samples) for name, samples in rows.items()}


run = cache(Run)


@each_machine
def test_the_work_of_drives_is_what_lifts_and_speeds_up_the_bodies(name):
    drives, done = DRIVES[name], run(name, 1e-3)
    forces, positions = done.signals[drives.force], done.signals[drives.position]
    by_period = (0.5 * (forces[1:] + forces[:-1]) * np.diff(positions, axis=0)).sum(axis=1)
    moving = done.time > MOVED
    work, gained = by_period[moving[:-1]].sum(), done.energy[moving][-1] - done.energy[moving][0]
    assert gained > 0.02
    assert -1e-4 < 1.0 - gained / work < drives.lost


@each_machine
def test_gaps_of_closed_loops_fall_with_the_square_of_the_step(name):
    gaps = [run(name, step).signals["truth.loop_error"] for step in (1e-3, 5e-4)]
    coarse, fine = (gap[run(name, 1e-3).time > STOOD].max() for gap in gaps)
    assert 0.0 < coarse < 1e-5
    assert 3.5 < coarse / fine < 4.5


@each_machine
def test_error_control_agrees_with_steps(name):
    """Bodies within .5 mm and .5 mrad of those that take steps; drives bear the same."""
    steps, controlled = run(name, 1e-3), run(name, 1e-3, 1e-3)
    for signal in POSES & steps.signals.keys():
        np.testing.assert_allclose(controlled.signals[signal], steps.signals[signal], atol=5e-4)
    for begin, end in ((0.5 * STOOD, STOOD), (MOVED, OVER)):
        during = (steps.time > begin) & (steps.time < end)
        held = [done.signals[DRIVES[name].force][during] for done in (steps, controlled)]
        one, other = (force.mean(axis=0) for force in held)
        # Legs that strain each other share their load a little differently.
        assert np.abs(other - one).max() < 0.01 * np.abs(one).max() + 0.5


@each_machine
def test_a_tighter_accuracy_closes_loops_better(name):
    gaps = [run(name, 1e-3, a).signals["truth.loop_error"].max() for a in (1e-3, 1e-7)]
    assert 0.0 < gaps[1] < 0.6 * gaps[0] < 1e-6


@each_machine
def test_another_integrator_than_that_of_error_control_is_refused(name):
    settings = ["backend=multibody", "plant.accuracy=1e-3"]
    machine = find_machine(name)
    station = Station(machine, load_scenario(machine.scenario, None, None, settings))
    simulator = Simulator(station)
    root = simulator.get_mutable_context()
    for port in machine.inputs:
        station.GetInputPort(port.name).FixValue(root, np.full(port.size, port.idle))
    with pytest.raises(WiringError, match=r"plant\.accuracy = 0\.001 .* loop\.simulator\(\)"):
        simulator.AdvanceTo(0.01)


@each_on_feet
def test_the_ground_carries_the_weight(name):
    done = run(name, 1e-3)
    standing = (done.time > 0.5 * STOOD) & (done.time < STOOD)
    carried = done.signals["truth.contact_force"].sum(axis=1)[standing].mean()
    assert carried == pytest.approx(done.weight, rel=0.01)
