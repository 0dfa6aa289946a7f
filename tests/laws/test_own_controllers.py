"""Laws of controllers of one's own, proved for every experiment that runs one."""

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machine import list_machines
from parapod.diagrams.wiring import inputs_of, named_source, outputs_of
from parapod.sims.lab.discovery import list_entries
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.runner import read_what_there_is, refuse_deaf
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from tests.laws.test_experiments import BRIEF, quiet, scenario_of

KEY = "control.controller"
ENTRIES = [entry for entry in list_entries() if entry.package == "parapod"]


def has_key(schema):
    control = getattr(schema(), "control", None)
    return hasattr(control, "controller")


SETTABLE = [entry for entry in ENTRIES if has_key(entry.load().schema)]
RUN = [entry for entry in SETTABLE if isinstance(entry.load(), LoopExperiment)]
USUAL = "lambda scenario, machine: machine.controller(scenario)"
# The operation's controller has a supervisor besides.
SUPERVISED = """
from parapod.diagrams.levelling_platform.controller import make_supervised_controller

def make(scenario, machine):
    return make_supervised_controller(scenario)
"""
# That of the tip's points takes these.
POINTING = SUPERVISED.replace(".controller import", ".pointing import").replace(
    "make_supervised_controller", "make_pointing_controller"
)
HOLDING = POINTING.replace("controller(scenario)", "controller(scenario, has_payload=True)")
OTHERS = {"deploy": SUPERVISED, "inspect": POINTING, "tip-hold": HOLDING}
# Ports, and nothing behind them.
PORTS = """
import numpy as np
from pydrake.systems.framework import LeafSystem
from pydrake.trajectories import PiecewisePolynomial

class Ports(LeafSystem):
    def __init__(self, outputs, inputs={{}}, period=0.0):
        super().__init__()
        for name, size in inputs.items():
            self.DeclareVectorInputPort(name, size)
        used = self.nothing_ticket()
        for name, size in outputs.items():
            value = np.zeros(size)
            self.DeclareVectorOutputPort(
                name, size, lambda context, output, x=value: output.SetFromVector(x), {{used}}
            )
        if period:
            self.DeclareDiscreteState(1)
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, lambda context, state: None)

def make(scenario, machine):
    {body}
"""
each_machine = pytest.mark.parametrize("machine", list_machines(), ids=lambda m: m.name)


@pytest.fixture
def named(tmp_path):
    """named(text): the function `make` of a file of that text, as scenarios name it."""

    def write(text):
        (tmp_path / "mine.py").write_text(text)
        return f"{tmp_path}/mine.py:make"

    return write


def values(result):
    return {m.key: m.value for m in result.metrics if not m.is_timing}


@pytest.mark.parametrize("entry", RUN, ids=lambda entry: entry.name)
def test_the_machines_controller_in_a_file_changes_no_metric(entry, named):
    own = named(OTHERS.get(entry.name, f"make = {USUAL}"))
    usual, again = (
        entry.load().execute(scenario_of(entry, *BRIEF[entry.name], *more), quiet())
        for more in ((), (f"{KEY}={own}",))
    )
    assert values(again) == pytest.approx(values(usual), rel=0.0, abs=1e-12, nan_ok=True)
    assert again.notes == usual.notes


@pytest.mark.parametrize(
    "entry", [entry for entry in SETTABLE if entry not in RUN], ids=lambda entry: entry.name
)
def test_an_experiment_that_leads_its_machine_by_itself_refuses_one(entry):
    with pytest.raises(ScenarioError, match=f"{KEY} must be empty") as caught:
        entry.load().execute(scenario_of(entry, f"{KEY}=mine.py:make"), quiet())
    assert caught.value.key == KEY


def scenario_with(machine, own, backend="kinematic"):
    scenario = machine.scenario(backend=backend)
    scenario.control.controller = own
    return scenario


def ports_of(machine):
    """Sizes of the usual controller's outputs and inputs."""
    usual = machine.controller(machine.scenario())
    return [{n: p.size() for n, p in of(usual).items()} for of in (outputs_of, inputs_of)]


def refusal(machine, own, **options):
    """The one line with which a loop refuses a controller."""
    with pytest.raises(ParapodError) as caught:
        ClosedLoop(machine, scenario_with(machine, own, **options), log=())
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_every_machine_of_the_package_can_have_one():
    own = [
        machine
        for machine in list_machines()
        if type(machine.scenario()).__module__.startswith("parapod")
    ]
    assert {machine.name for machine in own} == {entry.load().machine.name for entry in RUN}


@each_machine
def test_ports_that_it_has_no_use_for_may_be_missing_and_others_are_recorded(machine, named):
    outputs, _ = ports_of(machine)
    scenario = scenario_with(
        machine, named(PORTS.format(body=f"return Ports({outputs} | {{'mine': 2}})"))
    )
    loop = ClosedLoop(machine, scenario)
    assert inputs_of(loop.controller) == {}
    assert loop.recording(loop.CreateDefaultContext()).units["mine"] == "-"


@each_machine
def test_commands_that_are_missing_are_named_with_those_that_there_are(machine, named):
    line = refusal(machine, named(PORTS.format(body="return Ports({'mine': 1})")))
    commands = {port.name for port in machine.inputs} & set(ports_of(machine)[0])
    assert all(name in line for name in commands)
    assert line.endswith("it has: mine")


@each_machine
def test_signals_of_the_controller_that_a_run_records_are_refused_by_name(machine, named):
    outputs, _ = ports_of(machine)
    inner = [n for n in outputs if machine.table[n].direction == "inner"]
    scenario = scenario_with(machine, named(f"make = {USUAL}"))
    loop = ClosedLoop(machine, scenario, log=())
    loop.require(inner)
    with pytest.raises(ParapodError, match=r"records nothing_such of the controller.* has only: "):
        loop.require(["nothing_such"])


@each_machine
def test_wrong_sizes_periods_and_loops_are_refused_in_a_line(machine, named):
    outputs, _ = ports_of(machine)
    command = next(port.name for port in machine.inputs if port.name in outputs)
    measured = machine.measured[0]
    for body, words in (
        (f"return Ports({outputs | {command: 77}})", f"'{command}' has 77 elements"),
        (f"return Ports({outputs}, {{'{measured.name}': 77}})", "but 77 as an input"),
        (
            f"return Ports({outputs}, {{'nothing_such': 1}})",
            "nothing drives the input 'nothing_such'",
        ),
        (
            f"return Ports({outputs}, period=1.5 * scenario.control.period)",
            "be a multiple of",
        ),
        ("return None", "must return a LeafSystem or Diagram, not null"),
        ("return Ports", "must return a LeafSystem or Diagram"),
        ("return 1 / 0", "ZeroDivisionError: division by zero (mine.py, line "),
        ("import nothing_such_at_all", "No module named 'nothing_such_at_all'"),
    ):
        assert words in refusal(machine, named(PORTS.format(body=body))), body
    for text, words in (
        ("mine.py:make", "there is no such file"),
        ("mine.py", "must be FILE.py:FUNCTION or PACKAGE.MODULE:FUNCTION"),
        ("no_such_package:make", "cannot be loaded: ModuleNotFoundError"),
    ):
        assert words in refusal(machine, text), text
    for text, words in (
        ("make = 1", "there is no function 'make'"),
        ("def make(scenario: pass", "cannot be loaded: SyntaxError"),
    ):
        assert words in refusal(machine, named(text)), text


def test_a_file_is_looked_for_beside_the_scenario_that_names_it(tmp_path, named):
    named(f"make = {USUAL}")
    (tmp_path / "mine.yaml").write_text("control: {controller: mine.py:make}\n")
    entry = next(entry for entry in RUN if entry.name == "level")
    scenario = load_scenario(entry.load().schema, entry.default_scenario, tmp_path / "mine.yaml")
    assert scenario.control.controller == f"{tmp_path}/mine.py:make"


def test_a_loop_of_one_serves_no_other_beginning(named):
    machine = next(machine for machine in list_machines() if machine.name == "levelling_platform")
    for own, is_shared in (("", True), (named(f"make = {USUAL}"), False)):
        one, other = (scenario_with(machine, own) for _ in range(2))
        other.seed = 1
        assert (machine.structure(one) == machine.structure(other)) is is_shared


def test_it_is_a_leaf_system_that_the_file_itself_defines(named):
    machine = next(machine for machine in list_machines() if machine.name == "levelling_platform")
    outputs, _ = ports_of(machine)
    own = named(PORTS.format(body=f"return Ports({outputs})"))
    loop = ClosedLoop(machine, scenario_with(machine, own), log=())
    assert isinstance(loop.controller, LeafSystem)


@pytest.mark.parametrize("entry", RUN, ids=lambda entry: entry.name)
def test_numbers_beside_the_scene_do_without_ports_that_it_lacks(entry, named):
    machine = entry.load().machine
    outputs, _ = ports_of(machine)
    commands = {port.name for port in machine.inputs}
    needed = {name: size for name, size in outputs.items() if name in commands}
    own = named(PORTS.format(body=f"return Ports({needed})"))
    loop = ClosedLoop(machine, scenario_with(machine, own), sources=(), log=())
    shown = read_what_there_is(entry.load().read_out, loop, loop.CreateDefaultContext())
    assert [row.label for row in shown.rows] == ["time"]
    reads_time_alone = type(entry.load()).read_out is LoopExperiment.read_out
    assert reads_time_alone or "has no port" in shown.remarks[0]


def test_a_person_does_not_operate_a_controller_that_hears_no_commands(named):
    platform = next(machine for machine in list_machines() if machine.name == "levelling_platform")
    outputs, _ = ports_of(platform)
    sliders = named_source("posture_command", PiecewisePolynomial(np.zeros(3)))
    sliders.shown = None  # as sources have it that a person moves
    usual = named(f"make = {USUAL}")
    refuse_deaf(ClosedLoop(platform, scenario_with(platform, usual), log=()))
    own = named(PORTS.format(body=f"return Ports({outputs})"))
    loop = ClosedLoop(platform, scenario_with(platform, own), sources=(sliders,), log=())
    with pytest.raises(ParapodError, match="by the controller's input posture_command"):
        refuse_deaf(loop)
