"""The legs of the simulated bodies are where the actuators are, at the same instant."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario, PlantScenario
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import inputs_of
from parapod.systems.levelling_platform.leg import swing_angle

TIME_STEP = 1e-3


def extension_of(model, leg, context):
    """Extension of an actuator that the joints of its leg show [m]."""
    instance = model.legs[leg]
    if model.is_full:
        return model.plant.GetJointByName("extension", instance).get_translation(context)
    angle = model.plant.GetJointByName("swing", instance).get_angle(context)
    extensions = np.linspace(0.38, 0.46, 801)
    angles = np.array([swing_angle(model.geometry.legs[leg], d) for d in extensions.tolist()])
    order = np.argsort(angles)
    return float(np.interp(angle, angles[order], extensions[order]))


@pytest.mark.parametrize("voltage", [4.0, -4.0])
@pytest.mark.parametrize("leg_model", ["full", "reduced"])
def test_moving_legs_trail_their_actuators_by_no_step(leg_model, voltage):
    plant = PlantScenario(time_step=TIME_STEP, leg_model=leg_model)
    station = Station(PLATFORM, LevellingScenario(plant=plant))
    simulator = Simulator(station)
    root = simulator.get_mutable_context()
    for name, port in inputs_of(station).items():
        port.FixValue(root, np.full(port.size(), voltage if name == "legs.voltage" else 0.0))
    simulator.AdvanceTo(0.3)
    model, actuators = station.behind.handle.model, station.behind.handle.actuators
    context = model.plant.GetMyContextFromRoot(root)
    extension, velocity = (
        actuators.GetOutputPort(name).Eval(actuators.GetMyContextFromRoot(root))
        for name in ("extension", "velocity")
    )
    found = np.array([extension_of(model, leg, context) for leg in range(4)])
    a_step = TIME_STEP * velocity
    assert np.abs(a_step).min() > 3e-5
    # What the rods give way by under their loads is a fifth of a step.
    steps_late = (extension - found) @ a_step / (a_step @ a_step)
    assert abs(steps_late) < 0.3
