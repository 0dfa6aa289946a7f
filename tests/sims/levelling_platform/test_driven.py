"""A machine without its controller: what nothing drives is idle."""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.parts import SensorScenario
from parapod.diagrams.levelling_platform.scenario import PlantScenario
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import add, connect
from parapod.sims.levelling_platform.leg_job import make_simulator, on_level_ground
from parapod.sims.levelling_platform.slip.scenario import SlipScenario


@pytest.fixture(scope="module")
def standing():
    """A station of which only the arm is driven, and a simulator of it."""
    scenario = SlipScenario(seed=2, plant=PlantScenario(leg_model="reduced", time_step=0.01))
    builder = DiagramBuilder()
    station = Station(PLATFORM, on_level_ground(scenario, SensorScenario(), 405.0))
    machine = add(builder, station)
    arm = add(builder, ConstantVectorSource(np.array([0.0, 0.3])), "arm")
    connect(builder, arm.get_output_port(), machine.GetInputPort("arm.position_command"))
    return station, make_simulator(builder, station)


def test_what_is_driven_stays_so_and_the_rest_is_idle_with_wheels_braked(standing):
    station, simulator = standing
    context = station.GetMyContextFromRoot(simulator.get_context())
    ports = [station.get_input_port(i) for i in range(station.num_input_ports())]
    values = {port.get_name(): port.Eval(context).tolist() for port in ports}
    driven = {"arm.position_command": [0.0, 0.3], "wheels.brake": [1.0]}
    assert driven.items() <= values.items()
    assert all(not any(value) for name, value in values.items() if name not in driven)


def test_the_machine_stands_level_on_level_ground(standing):
    station, simulator = standing
    context = station.GetMyContextFromRoot(simulator.get_context())
    posture = station.GetOutputPort("truth.posture").Eval(context)
    extension = station.GetOutputPort("truth.extension").Eval(context)
    assert np.allclose(posture[:2], 0.0, atol=1e-6)
    assert np.allclose(extension, 0.405)
