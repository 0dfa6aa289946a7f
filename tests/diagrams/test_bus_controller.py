"""A platform whose controller is another program: levelled, and safe when that is killed."""

import os
import subprocess
import sys
import time
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.devices import Parts
from parapod.diagrams.drivers.bus import PARTS, parts_on_bus
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.machine import list_machines
from parapod.diagrams.station import Station
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from tests.systems.hardware.buses.conftest import lcm_url, until  # noqa: F401

EXAMPLES = Path(__file__).parents[2] / "examples" / "buses"


def loop_of(address, *settings):
    overrides = (f"control.controller={address}", "backend=kinematic", *settings)
    return ClosedLoop(PLATFORM, load_scenario(PLATFORM.scenario, overrides=overrides))


@pytest.fixture
def lcm_address(lcm_url):  # noqa: F811
    return f"lcm://{lcm_url.removeprefix('udpm://')}"


@pytest.fixture(params=["lcm", "ros2"])
def foreign(request):
    """Address of a bus, and a program on it that has nothing of parapod's."""
    if request.param == "lcm":
        pytest.importorskip("lcm", reason="the example needs LCM's own library")
        address = request.getfixturevalue("lcm_address")
        arguments, environment = [address.replace("lcm://", "udpm://")], {}
    else:
        pytest.importorskip("rclpy", reason="ROS 2 is not installed")
        domain = str(1 + crc32(f"{os.getpid()} {time.time_ns()}".encode()) % 100)
        address, arguments, environment = f"ros2://{domain}", [], {"ROS_DOMAIN_ID": domain}
    program = subprocess.Popen(
        [sys.executable, f"level_{request.param}.py", *arguments],
        cwd=EXAMPLES,
        stderr=subprocess.PIPE,
        env=os.environ | environment,
    )
    yield address, program
    program.kill()
    program.communicate()


def test_another_program_levels_the_platform_and_its_end_leaves_it_neutral(foreign):
    address, program = foreign
    loop = loop_of(address, "ground={roll_deg: 2, pitch_deg: 3}")
    simulator = loop.simulator()
    station = loop.controller.station

    def heard():  # by a program that takes its time to begin
        # An end of an instant whose beginning it has not heard.
        station.bus.publish(station.bus.address.channels_of("station").status, _nothing())
        return program.poll() is not None or _answers(loop, simulator)

    until(heard, 60.0)
    assert program.poll() is None, program.stderr.read().decode()
    simulator.AdvanceTo(8.0)
    recording = loop.recording(simulator.get_context())
    roll, pitch, _ = np.degrees(recording["truth.posture"]).T
    assert abs(roll[0]) + abs(pitch[0]) > 4.5
    assert np.hypot(roll[-1], pitch[-1]) < 0.1
    assert np.abs(recording["legs.voltage"]).max() > 0.5
    program.kill()
    program.wait()
    simulator.AdvanceTo(8.05)
    context = loop.controller.GetMyContextFromRoot(simulator.get_context())
    np.testing.assert_array_equal(loop.controller.GetOutputPort("legs.voltage").Eval(context), 0.0)
    (legs,) = (part for part in station.parts if part.part == "legs")
    assert legs.is_neutral
    assert f"no message on {station.bus.address.channels_of('legs').command}" in legs.latched.words
    loop.controller.close()


def _nothing():
    from parapod.systems.hardware.buses.message import Message

    return Message((), (), 1.0)


def _answers(loop, simulator):
    """Whether a first instant has been answered."""
    try:
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.01)
    except ParapodError:
        return False
    return True


def test_a_controller_that_is_not_there_is_told_of_in_a_line(lcm_address):
    loop = loop_of(lcm_address)
    with pytest.raises(ParapodError) as caught:
        loop.simulator().AdvanceTo(0.05)
    loop.controller.close()
    text = str(caught.value)
    assert text.startswith("no commands in 2 s: no message on LEGS_COMMAND yet")
    assert "\n" not in text


def test_a_controller_on_a_bus_of_another_kind_is_refused_with_those_that_there_are():
    with pytest.raises(ScenarioError, match="'ros3://' must begin with lcm or ros2"):
        loop_of("ros3://")


@pytest.mark.parametrize("machine", list_machines(), ids=lambda machine: machine.name)
def test_every_machine_may_have_its_controller_on_a_bus(machine):
    scenario = machine.scenario()
    scenario.control.controller = "lcm://"
    loop = ClosedLoop(machine, scenario)
    outputs = {port.name for port in loop.machine.inputs}
    assert outputs <= {
        loop.controller.get_output_port(i).get_name()
        for i in range(loop.controller.num_output_ports())
    } | {name for source in loop.sources for name in _outputs(source)}
    channels = loop.controller.station.published
    loop.controller.close()
    for part in machine.parts:
        if any(port.part == part for port in machine.measured):
            assert f"{part.upper()}_STATUS" in channels
    # Arrays without labels come in an order that is always the same: that of the table.
    devices = [port.name for port in loop.machine.outputs if port.part == "status"]
    names = [f"status.{name}" for name in channels["STATION_STATUS"] if name != "latched"]
    assert names == ["status.neutral", *devices]
    # What only a simulation knows is not on the bus.
    assert not any("truth" in name for sizes in channels.values() for name in sizes)


def _outputs(system):
    return [system.get_output_port(i).get_name() for i in range(system.num_output_ports())]


@pytest.mark.parametrize("machine", list_machines(), ids=lambda machine: machine.name)
@pytest.mark.parametrize("kind", PARTS)
def test_every_machine_may_have_all_of_its_parts_on_a_bus(machine, kind):
    scenario = machine.scenario()
    scenario.backend = "hardware"
    scenario.hardware.drivers = parts_on_bus(machine.for_scenario(scenario), kind)
    station = Station(machine, scenario)
    threads = station.behind.handle_as(Parts).all_threads
    commanded = {
        f"{d.part}.{n}"
        for d, t in zip(scenario.hardware.drivers, threads, strict=True)
        for n in t.device.commands
    }
    assert commanded == {port.name for port in machine.for_scenario(scenario).inputs}


@pytest.mark.parametrize("backend", ["hardware", "kinematic"])
def test_a_real_machine_waits_for_no_controller(lcm_address, backend):
    address = lcm_address
    overrides = (f"control.controller={address}", f"backend={backend}")
    scenario = load_scenario(PLATFORM.scenario, overrides=overrides)
    controller = PLATFORM.for_scenario(scenario).controller_of(scenario)
    context = controller.CreateDefaultContext()
    for i in range(controller.num_input_ports()):
        port = controller.get_input_port(i)
        port.FixValue(context, np.zeros(port.size()))
    simulator = Simulator(controller, context)
    if backend == "hardware":
        simulator.AdvanceTo(0.05)
        output = controller.GetOutputPort("wheels.brake").Eval(simulator.get_context())
        np.testing.assert_array_equal(output, 1.0)
        # Of legs, wheels and arm; the inertial sensor takes no commands.
        assert controller.GetOutputPort("neutral").Eval(simulator.get_context()) == 3.0
    else:
        with pytest.raises(ParapodError, match="no commands in 2 s"):
            simulator.AdvanceTo(0.05)
    controller.close()
