import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import Adder, ConstantVectorSource
from pydrake.trajectories import PiecewisePolynomial

import parapod
from parapod.diagrams.alone import Alone
from parapod.diagrams.machine import find_machine
from parapod.diagrams.station import Station
from parapod.systems.actuators.linear_actuator import LinearActuator, LinearActuatorParams
from parapod.systems.core.errors import WiringError
from parapod.systems.levelling_platform.kinematic_platform import KinematicPlatform

IDEAL = LinearActuatorParams(model="integrator")


def recorded(alone, until):
    simulator = Simulator(alone)
    simulator.AdvanceTo(until)
    return alone.recording(simulator.get_context())


def test_a_system_is_driven_by_constants_trajectories_and_systems():
    voltage = PiecewisePolynomial.FirstOrderHold([0.0, 1.0], [[0.0, 4.0]])
    rod = LinearActuator(IDEAL, channels=1, extension=0.4)
    sources = {"voltage": voltage, "stop": 0.0, "load_force": ConstantVectorSource([7.0])}
    recording = recorded(Alone(rod, sources, period=0.1), 1.0)
    assert recording.time == pytest.approx(np.arange(11) / 10)
    assert recording["voltage"][:, 0] == pytest.approx(0.4 * np.arange(11))
    # K = .01 (m/s)/V, and the mean of the voltage is 2 V.
    assert recording["extension"][-1, 0] - 0.4 == pytest.approx(0.02, rel=2e-3)
    assert (recording["load_force"] == 7.0).all()


def test_a_number_stands_for_all_elements_and_inputs_that_are_left_out_stay_unconnected():
    recording = recorded(Alone(KinematicPlatform(), {"extension": 0.41, "velocity": 0.0}), 0.0)
    assert recording["extension"].tolist() == [[0.41] * 4]
    assert "arm_position" not in recording
    assert recording["posture"][0, 2] == pytest.approx(0.4465, abs=1e-4)


def test_units_are_those_of_the_port_table():
    recording = recorded(Alone(KinematicPlatform(), {"extension": 0.41, "velocity": 0.0}), 0.0)
    assert recording.units["posture"] == "rad, rad, m"
    assert recording.units["extension"] == "m"
    assert recorded(Alone(Adder(2, 1), {"u0": 1.0, "u1": 2.0}), 0.0).units["sum"] == "-"


def test_units_of_a_station_are_those_of_its_machine():
    machine = find_machine("levelling_platform")
    station = Station(machine, parapod.scenario("level", backend="mock"))
    alone = Alone(station, {port.name: port.idle for port in machine.inputs})
    assert recorded(alone, 0.0).units["legs.voltage"] == "V"


@pytest.mark.parametrize(
    ("inputs", "words"),
    [
        ({"volts": 1.0}, "no input 'volts'; there are: voltage, load_force, stop"),
        ({"voltage": [1.0, 2.0]}, "'voltage' of 'linear_actuator' has 1 elements, its source 2"),
        ({"stop": KinematicPlatform()}, "has 10 outputs; a source of 'stop' has one"),
    ],
)
def test_what_does_not_fit_an_input_is_refused(inputs, words):
    with pytest.raises(WiringError, match=words):
        Alone(LinearActuator(channels=1), inputs)


def test_a_recording_needs_a_period():
    with pytest.raises(ValueError, match="must be positive, not 0"):
        Alone(LinearActuator(channels=1), {}, period=0.0)
