"""What the commands for hardware know of each machine is what its diagrams are."""

from dataclasses import replace

import pytest
from pydrake.systems.framework import InputPortIndex, OutputPortIndex

from parapod.diagrams.hardware_parts import make_parts
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.machines import MACHINES, machine_of
from parapod.sims.experiment import ENTRIES, experiments
from parapod.sims.signal_units import unit_of, with_units
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import fields_of

each_machine = pytest.mark.parametrize("machine", MACHINES, ids=lambda m: m.experiment)


def backends_of(machine):
    return fields_of(machine.scenario)["backend"][1].options


def described(diagram):
    """The exported ports as (name, size, type), inputs and outputs."""
    inputs = [diagram.get_input_port(InputPortIndex(i)) for i in range(diagram.num_input_ports())]
    outputs = [
        diagram.get_output_port(OutputPortIndex(i)) for i in range(diagram.num_output_ports())
    ]
    return [
        {(port.get_name(), port.size(), port.get_data_type()) for port in ports}
        for ports in (inputs, outputs)
    ]


@pytest.fixture(scope="module")
def ports():
    """Of the station of each backend of each machine."""
    return {
        (machine.experiment, backend): described(
            machine.make_station(machine.scenario(backend=backend)).diagram
        )
        for machine in MACHINES
        for backend in backends_of(machine)
    }


@each_machine
def test_all_backends_have_equal_ports_by_name_size_and_type(ports, machine):
    hardware = ports[machine.experiment, "hardware"]
    for backend in backends_of(machine):
        inputs, outputs = ports[machine.experiment, backend]
        assert inputs == hardware[0], backend
        observed = {port for port in outputs if not port[0].startswith("truth.")}
        assert observed == hardware[1], backend


@each_machine
def test_every_port_is_in_the_table_with_unit_and_meaning(ports, machine):
    for backend in backends_of(machine):
        shown = ports[machine.experiment, backend]
        inputs, outputs = ({(name, size) for name, size, _ in side} for side in shown)
        truth = machine.truth if backend in machine.simulated else ()
        specs = (*machine.outputs, *truth)
        assert inputs == {(spec.name, spec.size) for spec in machine.inputs}
        assert outputs == {(spec.name, spec.size) for spec in specs}
        assert all(spec.unit.strip() and spec.meaning.strip() for spec in specs)


@each_machine
def test_every_signal_that_a_closed_loop_can_record_has_a_unit(machine):
    loop = machine.make_closed_loop(machine.scenario(backend="mock"))
    units = with_units(dict.fromkeys(loop.ports, 0.0), machine)
    assert all(unit.strip() for _, unit in units.values())
    assert not loop.logs


def test_a_signal_of_two_machines_has_one_unit_or_needs_to_be_asked_of_one(monkeypatch):
    assert unit_of("legs.voltage") == "V"
    assert unit_of("position_node") == "m"
    assert unit_of("fault.legs.extension.0.stuck") == "0/1"
    with pytest.raises(KeyError, match="no machine has it"):
        unit_of("rudder.angle")
    first = MACHINES[0]
    other = replace(first, signals={"phase": "kg"})
    monkeypatch.setattr("parapod.sims.signal_units.MACHINES", (first, other))
    with pytest.raises(KeyError, match="phase: -, kg"):
        unit_of("phase")
    assert unit_of("phase", other) == "kg"


@each_machine
def test_what_is_idle_and_what_moves_are_ports(machine):
    inputs = {spec.name for spec in machine.inputs}
    measured = {spec.name for spec in machine.measured}
    assert set(machine.idle) <= inputs
    for part, motion in machine.motions.items():
        assert {f"{part}.{name}" for name in (motion.command, *motion.rest)} <= inputs
        assert f"{part}.{motion.measured}" in measured
        assert 0.0 < motion.usual <= motion.largest


@each_machine
def test_its_default_drivers_make_the_machine(machine):
    scenario = machine.scenario()
    parts = make_parts(scenario.hardware.drivers, machine.inputs, machine.measured, 0.01)
    assert set(parts.threads) == {spec.name.partition(".")[0] for spec in machine.measured} | {
        spec.name.partition(".")[0] for spec in machine.inputs
    }


@each_machine
def test_a_machine_is_found_by_its_scenario_and_has_an_experiment(machine):
    assert machine_of(machine.scenario()) is machine
    found = experiments([entry for entry in ENTRIES if entry.name == machine.experiment])
    assert found[machine.experiment].scenario is machine.scenario
    assert set(machine.simulated) < set(backends_of(machine))


def test_what_is_of_no_machine_is_refused_with_those_that_are():
    with pytest.raises(ScenarioError, match=r"HardwareScenario is not of .* level, chair-walk"):
        machine_of(HardwareScenario())


@each_machine
def test_the_station_behind_emulated_devices_exchanges_at_their_period(machine):
    scenario = machine.scenario(backend="kinematic")
    behind = machine.behind_devices(scenario, 0.004)
    assert behind.control.period == 0.004
    assert scenario == machine.scenario(backend="kinematic")
