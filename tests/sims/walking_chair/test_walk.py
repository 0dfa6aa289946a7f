"""The experiment `chair-walk`: short walks, refusals, files."""

import io
import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from rich.console import Console

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.ports import OUTPUTS, TRUTH_OUTPUTS
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.sims.cli.main import main
from parapod.sims.lab.experiment import RunOptions
from parapod.sims.lab.figures import render
from parapod.sims.lab.files import read_log
from parapod.sims.walking_chair.walk import EXPERIMENT, LiveChair, check_walk, measure, run
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.walking_chair.checks import ForceExceeded, SpeedExceeded, StrokeExceeded
from parapod.systems.walking_chair.support import SupportLost

DEFAULT = Path(str(files("parapod.sims.scenarios"))) / "chair-walk.yaml"
FORWARD = ("gait.way=forward", "plant.time_step=0.005", "begin=0.5", "end=0.5")
SIZES = {spec.name: spec.size for spec in (*OUTPUTS, *TRUTH_OUTPUTS)} | {
    "gait_time": 1,
    "done": 1,
    "hold": 1,
    "support": 4,
    "support_margin": 1,
    "payload_estimated": 3,
}
KEYS = {"body_error_mm", "tilt_deg", "peak_force_N", "realtime_factor"}


def scenario_with(*overrides):
    return load_scenario(ChairScenario, DEFAULT, None, overrides)


@pytest.fixture
def options():
    return RunOptions(console=Console(file=io.StringIO()))


@pytest.fixture(scope="module")
def result():
    return run(scenario_with(*FORWARD), RunOptions(console=Console(file=io.StringIO())))


def test_a_walk_with_the_papers_passenger_holds_all_bounds(result):
    assert result.passed, result.broken
    found = result.as_json()
    assert found.keys() >= KEYS
    assert found["body_error_mm"] <= 1.0
    assert found["tilt_deg"] <= 0.1
    assert found["peak_force_N"] <= 250.0
    bounds = {metric.key: metric.bound for metric in result.metrics}
    assert bounds["body_error_mm"] == 1.0
    assert bounds["tilt_deg"] == 0.1
    assert bounds["peak_force_N"] == 250.0
    assert bounds["drift_mm"] == 5.0
    assert bounds["foot_below_ground_mm"] <= 0.02


def test_loops_are_closed_to_a_micrometre_at_the_default_step():
    # Through the lift and the first half of a swing, which is as much as loops ever bear.
    scenario = scenario_with("gait.way=forward", "begin=0", "gait.phase_duration=4.7")
    loop = ClosedLoop(CHAIR, scenario, log=("truth.loop_error", "truth.force"))
    simulator = Simulator(loop)
    loop.reset(simulator.get_mutable_context())
    simulator.Initialize()
    simulator.AdvanceTo(7.0)
    _, signals = loop.recorded(simulator.get_context())
    assert 0.0 < signals["truth.loop_error"].max() < 1e-6
    assert np.abs(signals["truth.force"]).max() < 250.0


def test_loops_have_a_bound_where_the_step_is_fine():
    bounds = {}
    for step in (1e-3, 5e-3):
        scenario = scenario_with(*FORWARD)
        scenario.plant.time_step = step
        time = np.arange(10) * 0.1
        signals = {name: np.zeros((10, size)) for name, size in SIZES.items()}
        signals["done"][-1] = 1.0
        signals["support_margin"][:] = 0.05
        signals["gait_time"][:, 0] = time
        signals["truth.loop_error"][3, 2] = 1.5e-6
        found = measure(scenario, time, signals, 1.0)
        (loop,) = (metric for metric in found.metrics if metric.key == "loop_error_um")
        assert loop.value == pytest.approx(1.5)
        bounds[step] = loop.bound, loop.passed
    assert bounds == {1e-3: (1.0, False), 5e-3: (None, True)}


def test_the_kinematic_plant_walks_two_cycles_without_drift(options):
    overrides = (*FORWARD, "backend=kinematic", "gait.cycles=2", "gait.phase_duration=4.7")
    found = run(scenario_with(*overrides), options).as_json()
    assert found["drift_mm"] < 0.5
    assert found["body_error_mm"] <= 1.0


def test_figures_can_be_drawn(result):
    names = [figure.name for figure in result.figures]
    assert names == ["chair_walk_body", "chair_walk_currents", "chair_walk_margin"]
    for figure in result.figures:
        assert b"<svg" in render(figure)


def test_a_passenger_beyond_the_margin_is_refused_in_millimetres():
    with pytest.raises(SupportLost) as caught:
        check_walk(scenario_with("passenger.x_mm=100", "passenger.y_mm=50"))
    text = str(caught.value)
    assert f"{1e3 * caught.value.margin:.1f} mm" in text
    assert caught.value.margin < 0.0
    assert "first swing" in text
    assert "\n" not in text


def test_the_command_refuses_a_passenger_before_anything_moves(tmp_path, capsys):
    out = tmp_path / "walk.json"
    code = main(
        ["run", "chair-walk", "--set", "passenger.x_mm=100", "--set", "passenger.y_mm=50",
         "--json", str(out)]
    )  # fmt: skip
    assert code != 0
    error = capsys.readouterr().err
    assert "support margin of -3.4 mm" in error
    assert len(error.strip().splitlines()) == 1
    assert not out.exists()


@pytest.mark.parametrize(
    ("override", "error", "words"),
    [
        ("gait.lift_mm=110", StrokeExceeded, "branch"),
        ("gait.phase_duration=4.6", SpeedExceeded, "mm/s"),
        ("passenger.mass_kg=200", ForceExceeded, "427.3 N"),
        ("control.support_margin_mm=60", SupportLost, "60.0 mm"),
        ("control.period=0.001", ScenarioError, "control.period"),
    ],
)
def test_what_the_chair_cannot_do_is_refused(override, error, words):
    extra = ("plant.time_step=0.002",) if "period=" in override else ()
    with pytest.raises(error, match=words):
        check_walk(scenario_with(override, *extra))


def test_a_walk_that_was_held_is_an_error_with_the_margin(result):
    scenario = scenario_with(*FORWARD)
    n = 50
    signals = {
        "done": np.zeros((n, 1)),
        "hold": np.repeat((0.0, 1.0), n // 2)[:, None],
        "gait_time": np.linspace(0.0, 2.0, n)[:, None],
        "support_margin": np.full((n, 1), 0.004),
    }
    with pytest.raises(SupportLost, match=r"4\.0 mm"):
        measure(scenario, np.arange(n) * 0.02, signals, 1.0)


def test_log_and_json_are_written(tmp_path):
    log, out = tmp_path / "walk.npz", tmp_path / "walk.json"
    arguments = ["run", "chair-walk", "--log", str(log), "--json", str(out)]
    for override in (*FORWARD, "backend=mock"):
        arguments += ["--set", override]
    assert main(arguments) == 0
    assert json.loads(out.read_text())["experiment"] == "chair-walk"
    found = read_log(log)
    assert found.signals["legs.position"].shape[1] == 12
    assert found.metadata["units"]["legs.current"] == "A"
    assert set(found.metadata["units"]) == set(found.signals)


def test_the_mock_walks_without_a_machine(options):
    found = run(scenario_with(*FORWARD, "backend=mock"), options)
    assert found.passed, found.broken
    assert "body_error_mm" not in found.as_json()


@pytest.mark.parametrize("backend", ["kinematic", "multibody"])
def test_live_sliders_move_the_passenger_and_the_chair_waits(backend):
    meshcat = Meshcat()
    scenario = scenario_with(f"backend={backend}", "plant.time_step=0.005", "begin=0.2")
    chair = LiveChair(scenario, meshcat)
    with chair.sliders():
        chair.begin()
        for _ in range(10):
            chair.advance()
        assert chair.asked().mass == 57.0
        assert chair.signal("hold") == 0.0
        meshcat.SetSliderValue("to the right [mm]", 150.0)
        meshcat.SetSliderValue("ahead [mm]", 100.0)
        for _ in range(30):
            chair.advance()
        assert chair.asked().x == pytest.approx(0.15)
        assert chair.signal("hold") == 1.0
        held = chair.signal("gait_time")
        assert held < 5.0
        meshcat.SetSliderValue("to the right [mm]", 0.0)
        meshcat.SetSliderValue("ahead [mm]", 0.0)
        for _ in range(40):
            chair.advance()
        assert chair.signal("hold") == 0.0
        assert chair.signal("gait_time") > held
    assert meshcat.GetSliderNames() == []


def test_the_chair_walks_on_until_told_to_stop(options):
    meshcat = Meshcat()
    scenario = scenario_with("backend=kinematic", "begin=0", "gait.way=forward")
    chair = LiveChair(scenario, meshcat)
    looks = []
    with chair.sliders():
        chair.walk(lambda: len(looks) >= 3 or looks.append(0))
    assert 0.0 < chair.signal("gait_time") < 1.0


def test_backends_are_those_of_the_station():
    assert EXPERIMENT.backends == ("multibody", "kinematic", "mock", "hardware")
