"""Laws of every machine that is installed, and of every backend of each."""

import functools
import gc
import re
import subprocess
import sys
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FrameIndex
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem, PortDataType
from pydrake.systems.primitives import ConstantVectorSource, PassThrough

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.devices import make_parts
from parapod.diagrams.machine import find_machine, list_machines
from parapod.diagrams.ports import Behind, In, Out
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import inputs_of, leaf_systems, outputs_of
from parapod.systems.core.errors import ParapodError, ScenarioError, WiringError
from parapod.systems.core.extras import EXTRAS
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.core.schema import fields_of, is_schema

MACHINES = list_machines()
ROOMS = Path(__file__).parents[2]
each_machine = pytest.mark.parametrize("machine", MACHINES, ids=lambda machine: machine.name)
each_backend = pytest.mark.parametrize(
    ("machine", "backend"),
    [(machine, backend) for machine in MACHINES for backend in machine.backends],
    ids=lambda value: value if isinstance(value, str) else value.name,
)
each_simulated = pytest.mark.parametrize(
    ("machine", "backend"),
    [(machine, backend) for machine in MACHINES for backend in (*machine.plants, "mock")],
    ids=lambda value: value if isinstance(value, str) else value.name,
)


@each_backend
def test_a_station_has_the_ports_of_its_table(machine, backend):
    station = Station(machine, machine.scenario(backend=backend))
    is_simulated = backend in machine.plants
    wanted = (*machine.outputs, *(machine.truth if is_simulated else ()))
    for ports, found in (
        (machine.inputs, inputs_of(station)),
        (wanted, outputs_of(station)),
    ):
        assert {port.name: port.size for port in ports} == {
            name: port.size() for name, port in found.items()
        }
        assert {port.get_data_type() for port in found.values()} == {PortDataType.kVectorValued}


@each_machine
def test_a_signal_has_a_name_a_unit_and_a_meaning(machine):
    for port in machine.table.values():
        assert port.unit.strip()
        assert port.meaning.strip()
        assert port.name == port.name.strip()


@each_simulated
def test_a_closed_loop_records_every_port_with_its_unit(machine, backend):
    loop = ClosedLoop(machine, machine.scenario(backend=backend))
    simulator = Simulator(loop)
    loop.reset(simulator.get_mutable_context())
    simulator.AdvanceTo(0.05)
    recording = loop.recording(simulator.get_context())
    assert set(recording) == set(loop.ports)
    period = machine.scenario().control.period * machine.view.log_every
    assert np.allclose(np.diff(recording.time), period)
    for name, samples in recording.signals.items():
        assert recording.units[name].strip()
        assert samples.shape == (recording.time.size, loop.ports[name].size())


def switches_of(machine):
    """Commands of switches, of which 1 is the safe side."""
    return [port for port in machine.inputs if port.unit in ("-", "0/1")]


def moved(station, switch, command):
    """What a station shows while its drives move and a switch is commanded something."""
    simulator = Simulator(station)
    root = simulator.get_mutable_context()
    station.reset(root)
    if station.monitor is not None:
        simulator.set_monitor(station.monitor)
    for port in station.machine.inputs:
        station.GetInputPort(port.name).FixValue(root, np.full(port.size, port.idle))
    begun = {name: port.Eval(root) for name, port in outputs_of(station).items()}
    for port in station.machine.inputs:
        # From where it is, slowly.
        here = begun.get(f"{port.part}.position", np.zeros(port.size))
        value = here + 1e-4 if port.name.endswith("position_command") else np.full(port.size, 0.05)
        if port in switches_of(station.machine):
            value = np.zeros(port.size)
        if port.name == switch.name:
            value = np.full(port.size, command)
        station.GetInputPort(port.name).FixValue(root, value)
    simulator.AdvanceTo(0.2)
    return {name: port.Eval(root) for name, port in outputs_of(station).items()}


@each_machine
def test_a_switch_that_is_commanded_neither_0_nor_1_is_simulated_on_its_safe_side(machine):
    """As devices take it."""
    without_effect = {port.name for port in switches_of(machine)}
    for backend in machine.plants:
        station = Station(machine, machine.scenario(backend=backend))
        for switch in switches_of(machine):
            off, safe = moved(station, switch, 0.0), moved(station, switch, 1.0)
            if differing(off, safe):
                without_effect.discard(switch.name)
            for bad in (np.nan, -1.0, 1e300):
                assert differing(moved(station, switch, bad), safe) == [], (switch.name, bad)
    assert not without_effect


@each_simulated
def test_controllers_cannot_see_the_truth(machine, backend):
    loop = ClosedLoop(machine, machine.scenario(backend=backend), log=())
    for system in (loop.controller, *loop.sources):
        assert not [name for name in inputs_of(system) if name.startswith("truth.")]


@each_machine
def test_a_loop_without_faults_has_no_injector(machine):
    loop = ClosedLoop(machine, machine.scenario(backend="mock"), log=())
    assert loop.faults.injectors == {}


@each_machine
def test_a_loop_is_freed_when_nothing_refers_to_it(machine):
    loop = ClosedLoop(machine, machine.scenario(backend="kinematic"))
    simulator = Simulator(loop)
    loop.reset(simulator.get_mutable_context())
    simulator.AdvanceTo(0.02)
    alive = weakref.ref(loop)
    del loop, simulator
    gc.collect()
    assert alive() is None


@each_machine
def test_self_tests_move_parts_that_the_machine_has(machine):
    inputs = {port.name for port in machine.inputs}
    measured = {port.name for port in machine.measured}
    for part, move in machine.real.self_tests.items():
        names = {name if "." in name else f"{part}.{name}" for name in (move.command, *move.rest)}
        assert names <= inputs
        assert f"{part}.{move.measures}" in measured
        assert 0.0 < move.usual <= move.largest


@each_machine
def test_a_pressed_emergency_stop_closes_every_brake_and_drives_nothing(machine):
    inputs = {port.name for port in machine.inputs}
    brakes = {name for name in inputs if name.endswith((".brake", ".stop"))}
    assert brakes <= machine.real.cut.keys() <= inputs
    assert machine.real.cut == {name: float(name in brakes) for name in machine.real.cut}


@each_machine
def test_its_default_drivers_make_the_machine(machine):
    drivers = machine.drivers(machine.scenario())
    parts = make_parts(drivers, machine.inputs, machine.measured, 0.01)
    needed = [port for port in machine.measured if port.default is None]
    all_parts = {port.part for port in (*machine.inputs, *needed)}
    assert {parts.behind(part) for part in all_parts} == set(parts.threads)


@each_machine
def test_an_emulated_scenario_has_the_period_of_the_exchange(machine):
    scenario = machine.scenario(backend="kinematic")
    assert machine.real.emulated(scenario, 0.004).control.period == 0.004
    assert scenario == machine.scenario(backend="kinematic")
    assert set(machine.real.exchange) == set(machine.plants)


@each_machine
def test_a_plant_with_the_stations_ports_takes_its_place(machine):
    scenario = machine.scenario(backend="mock")
    station = Station(machine, scenario)
    loop = ClosedLoop(machine, scenario, plant=station, log=())
    assert loop.station is station


@each_machine
def test_a_plant_without_the_stations_ports_is_refused_by_the_first_that_is_missing(machine):
    scenario = machine.scenario(backend="mock")
    with pytest.raises(WiringError, match=rf"{machine.title} has no input 'u'"):
        ClosedLoop(machine, scenario, plant=PassThrough(2), log=())
    with pytest.raises(WiringError, match=rf"behind the input '.*' of {machine.title}"):
        ClosedLoop(machine, scenario, plant=ConstantVectorSource([1.0]), log=())


@each_machine
def test_a_plant_needs_the_ports_that_are_driven_and_read_and_no_others(machine):
    scenario = machine.scenario(backend="mock")
    loop = ClosedLoop(machine, scenario, log=())
    others = (loop.controller, *loop.sources)
    read = {name for system in others for name in inputs_of(system)}
    driven = outputs_of(loop.controller)
    outputs = {port.name: port.size for port in machine.outputs if port.name in read}
    inputs = {port.name: port.size for port in machine.inputs if port.name in driven}
    assert inputs
    assert outputs
    ClosedLoop(machine, scenario, plant=Ports(inputs, outputs), log=())
    for missing in outputs:
        left = {name: size for name, size in outputs.items() if name != missing}
        with pytest.raises(WiringError, match=f"behind the output '{missing}'"):
            ClosedLoop(machine, scenario, plant=Ports(inputs, left), log=())
    for missing in inputs:
        left = {name: size for name, size in inputs.items() if name != missing}
        with pytest.raises(WiringError, match=f"behind the input '{missing}'"):
            ClosedLoop(machine, scenario, plant=Ports(left, outputs), log=())


class Ports(LeafSystem):
    """Nothing but ports: their sizes by name."""

    def __init__(self, inputs, outputs):
        super().__init__()
        for name, size in inputs.items():
            self.DeclareVectorInputPort(name, size)
        for name, size in outputs.items():
            self.DeclareVectorOutputPort(name, size, lambda *_: None, {self.nothing_ticket()})


@each_machine
def test_an_unknown_backend_is_refused_with_those_that_there_are(machine):
    scenario = machine.scenario()
    object.__setattr__(scenario, "backend", "steam")
    known = ", ".join(machine.plants)
    with pytest.raises(ScenarioError, match=rf"'steam' is not one of {known}, mock"):
        Station(machine, scenario)


@each_machine
@pytest.mark.parametrize("fault", ["missing", "unknown", "size"])
def test_a_backend_whose_ports_are_not_the_tables_is_refused_by_name(machine, fault):
    def spoilt(builder, scenario, meshcat):
        behind = machine.plants["kinematic"](builder, scenario, meshcat)
        outputs, name = dict(behind.outputs), machine.outputs[0].name
        if fault == "missing":
            del outputs[name]
        elif fault == "unknown":
            outputs["rudder.angle"] = outputs[name]
        else:
            source = builder.AddSystem(ConstantVectorSource(np.zeros(99)))
            outputs[name] = source.get_output_port()
        return Behind(behind.inputs, outputs, behind.reset)

    name = "rudder.angle" if fault == "unknown" else machine.outputs[0].name
    with pytest.raises(WiringError, match=rf"'{re.escape(name)}'"):
        Station(
            replace(machine, plants={"kinematic": spoilt}), machine.scenario(backend="kinematic")
        )


@each_machine
def test_a_port_that_does_not_exist_cannot_be_recorded(machine):
    with pytest.raises(WiringError, match=r"no port 'truth.postre' to record; there are: "):
        ClosedLoop(machine, machine.scenario(backend="mock"), log=("truth.postre",))


@each_machine
def test_a_controller_with_an_input_that_nothing_drives_is_refused(machine):
    with pytest.raises(WiringError, match=r"nothing drives the input 'u'"):
        ClosedLoop(machine, machine.scenario(backend="mock"), controller=PassThrough(1))


def test_a_name_in_the_table_twice_is_refused():
    machine = MACHINES[0]
    twice = replace(machine, ports=(*machine.ports, machine.ports[0]))
    with pytest.raises(WiringError, match=f"declares the port '{machine.ports[0].name}' twice"):
        _ = twice.table


@pytest.mark.parametrize(("unit", "meaning"), [("", "speed"), ("m", " ")])
def test_a_port_without_a_unit_or_a_meaning_is_refused(unit, meaning):
    for make in (In, Out):
        with pytest.raises(WiringError, match=r"port 'part.signal' of size 1 has no"):
            make("part.signal", 1, unit, meaning)


def test_a_machine_that_does_not_exist_is_refused_with_those_that_do():
    with pytest.raises(
        ParapodError, match=f"no machine 'rocker'; there are: .*{MACHINES[0].name}"
    ):
        find_machine("rocker")


@each_machine
def test_importing_a_machine_loads_no_other_and_no_device_library(machine):
    program = (
        "import sys\n"
        "from parapod.diagrams.machine import find_machine\n"
        f"find_machine({machine.name!r}).scenario()\n"
        "print(*sorted(sys.modules))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.split())
    others = [other.name for other in MACHINES if other is not machine]
    assert not [name for name in loaded if name.split(".")[2:3] and name.split(".")[2] in others]
    assert not loaded & set(EXTRAS)
    assert not [name for name in loaded if name.startswith("matplotlib")]
    devices = {name for name in loaded if name.startswith("parapod.systems.hardware.")}
    settings = {name for name in devices if name.endswith(".settings")}
    assert settings
    packages = {name.rpartition(".")[0] for name in settings}
    of_settings = ("addresses", "soft_limits", "cia402.switches", "buses", "buses.address")
    beside = {f"parapod.systems.hardware.{name}" for name in of_settings}
    assert devices <= settings | packages | beside


def test_shared_code_names_no_machine_and_imports_none():
    machines = [machine.name for machine in MACHINES]
    shared = [
        path
        for room in ("systems", "diagrams", "sims")
        for path in (ROOMS / room).rglob("*.py")
        if not set(path.relative_to(ROOMS).parts) & set(machines)
    ]
    assert len(shared) > 50
    named = [
        f"{path.relative_to(ROOMS)}: {name}"
        for path in shared
        for name in machines
        if name in path.read_text(encoding="utf-8")
    ]
    assert named == []


# The beginning

# Scenarios that move what a beginning consists of, by machine; of others the defaults are tried.
BEGINNINGS = {
    "levelling_platform": (
        "ground.foot_heights_mm=[5,0,-3,2] ground.roll_deg=-1.5 plant.length_error_mm=1",
        "plant.leg_model=reduced plant.length_error_mm=2 plant.angle_error_deg=0.5 seed=3",
        "job.start=wheels job.start_x_m=0.4 plant.wheels=rolling plant.angle_error_deg=1",
        "job.initial_extension_mm=400 machine.sensors={imu_noise: false, imu_delay_ms: 30}",
        "faults=[{at: 0.02, target: legs.extension, kind: garbage}] seed=5",
    ),
    "walking_chair": (
        "passenger.mass_kg=41.3 passenger.x_mm=25 passenger.y_mm=-40 passenger.height_mm=310",
        "passenger.mass_kg=0",
        "gait.way=back gait.step_mm=80 machine.drives.gain_error=0.1 seed=5",
    ),
}
each_beginning = pytest.mark.parametrize(
    ("machine", "backend", "overrides"),
    [
        (machine, backend, overrides)
        for machine in MACHINES
        for backend in (*machine.plants, "mock")
        for overrides in ("", "seed=11", *BEGINNINGS.get(machine.name, ()))
    ],
    ids=lambda value: value if isinstance(value, str) else value.name,
)


def scenario_of(machine, backend, overrides):
    given = re.split(r" (?=[a-z])(?![^{]*})", overrides) if overrides else []
    return load_scenario(machine.scenario, None, None, [f"backend={backend}", *given])


def values_of(loop, root):
    """Everything in a context that a simulation begins with, by system and kind."""
    found = {}
    for number, system in enumerate(leaf_systems(loop)):
        context, name = system.GetMyContextFromRoot(root), f"{number} {type(system).__name__}"
        for i in range(context.num_discrete_state_groups()):
            found[f"{name}: state {i}"] = context.get_discrete_state(i).value().copy()
        for i in range(context.num_numeric_parameter_groups()):
            found[f"{name}: parameter {i}"] = context.get_numeric_parameter(i).value().copy()
        for i in range(context.num_abstract_parameters()):
            parameter = context.get_abstract_parameter(i)
            if isinstance(parameter, Value[object]):
                found[f"{name}: abstract parameter {i}"] = parameter.get_value()
        assert context.num_continuous_states() == 0
        if isinstance(system, MultibodyPlant):
            found[f"{name}: positions"] = system.GetPositions(context)
            for i in range(system.num_frames()):
                frame = system.get_frame(FrameIndex(i))
                pose = frame.CalcPoseInBodyFrame(context).GetAsMatrix4()
                found[f"{name}: pose of {frame.scoped_name()}"] = pose
    found["time"] = root.get_time()
    return found


def differing(one, other):
    assert one.keys() == other.keys()
    return [
        name
        for name, value in one.items()
        if not (
            np.array_equal(value, other[name], equal_nan=True)
            if isinstance(value, np.ndarray)
            else value == other[name]
        )
    ]


def begun(loop, *given):
    """Values with which a loop begins, and a short run; it is reset to what is given."""
    simulator = Simulator(loop)
    root = simulator.get_mutable_context()
    for scenario in given:
        loop.reset(root, scenario)
    values = values_of(loop, root)
    simulator.AdvanceTo(0.06)
    return values, loop.recording(simulator.get_context()).signals


# The newest `KEPT` loops, each built for another scenario of its structure.
SERVED = {}
KEPT = 8


@each_beginning
def test_a_beginning_is_the_same_however_it_is_reached(machine, backend, overrides):
    """By default, by a reset, by a reset to the scenario, and in a loop built from another one."""
    scenario = scenario_of(machine, backend, overrides)
    built = ClosedLoop(machine, scenario)
    values, run = begun(built)
    assert len(next(iter(run.values()))) > 2
    structure = machine.name, machine.structure(scenario)
    if structure not in SERVED:
        other = replace(scenario, seed=scenario.seed + 1)
        # Dimensions that are drawn from the seed are built in.
        is_built_in = backend in machine.plants and "seed" not in machine.resets(scenario)
        SERVED[structure] = ClosedLoop(machine, scenario if is_built_in else other)
        if len(SERVED) > KEPT:
            del SERVED[next(iter(SERVED))]
    for loop, given in ((built, None), (built, scenario), (SERVED[structure], scenario)):
        again, repeated = begun(loop, given)
        assert differing(values, again) == []
        assert differing(run, repeated) == []


@each_simulated
def test_the_seed_has_an_effect_on_what_is_simulated(machine, backend):
    loop = ClosedLoop(machine, machine.scenario(backend=backend, seed=1))
    one, other = (begun(loop, machine.scenario(backend=backend, seed=seed)) for seed in (1, 2))
    for first, second in zip(one, other, strict=True):
        assert bool(differing(first, second)) == (backend in machine.plants)


_SAID = {"job.initial_extension_mm": 407.5}


def _changed(kind, rule, value):
    """A value some way within its range, or a scenario of which all numbers are so."""
    if is_schema(kind):
        return replace(
            value,
            **{
                name: _changed(inner, rule, getattr(value, name))
                for name, (inner, rule) in fields_of(kind).items()
            },
        )
    if isinstance(value, list):
        return [_changed(float, rule, item) + 0.1 * i for i, item in enumerate(value)]
    return 7 if kind is int else value + 0.02 * (rule.high - rule.low)


@pytest.mark.parametrize(
    ("machine", "backend"),
    [(machine, backend) for machine in MACHINES for backend in machine.plants],
    ids=lambda value: value if isinstance(value, str) else value.name,
)
def test_reset_takes_over_whatever_a_machine_says_that_it_does(machine, backend):
    """A loop gives the numbers of one that was built with other values of all those keys."""
    one, other = (machine.scenario(backend=backend) for _ in range(2))
    assert "seed" in machine.resets(one)
    for key in machine.resets(one):
        *parts, last = key.split(".")
        part = functools.reduce(getattr, parts, other)
        value = getattr(part, last)
        if value is None:  # it follows from the machine, or is said
            setattr(part, last, _SAID[key])
        else:
            setattr(part, last, _changed(*fields_of(type(part))[last], value))
        assert part != functools.reduce(getattr, parts, one)
    assert machine.structure(one) == machine.structure(other)

    def run(loop):
        simulator = Simulator(loop)
        loop.reset(simulator.get_mutable_context(), other)
        begun = values_of(loop, simulator.get_context())
        simulator.AdvanceTo(0.06)
        return begun, loop.recording(simulator.get_context())

    (begun, served), (asked, built) = (run(ClosedLoop(machine, s)) for s in (one, other))
    assert differing(asked, begun) == []
    for name in built:
        assert np.array_equal(built[name], served[name], equal_nan=True), name


@each_machine
def test_what_is_built_in_is_of_another_structure(machine):
    one, other, mock = (machine.scenario(backend="kinematic") for _ in range(3))
    other.control.period *= 2.0
    mock.backend = "mock"
    assert len({machine.structure(scenario) for scenario in (one, other, mock)}) == 3


@each_machine
def test_a_station_alone_begins_with_its_scenario(machine):
    for backend in (*machine.plants, "mock"):
        station = Station(machine, machine.scenario(backend=backend, seed=7))
        context = station.CreateDefaultContext()
        station.reset(context)
        default = values_of(station, station.CreateDefaultContext())
        assert differing(default, values_of(station, context)) == []
