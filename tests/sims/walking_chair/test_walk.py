"""The experiment `chair-walk`: a walk, its bounds, and the sliders after it."""

import time

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.sims.lab.discovery import find_entry
from parapod.sims.lab.panel import Panel
from parapod.sims.lab.run import Run
from parapod.sims.lab.runner import END
from parapod.sims.output.logs.files import read_log
from parapod.sims.walking_chair.walk import (
    ChairWalk,
    LiveChair,
    body_desired,
    lengths_desired,
)
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.walking_chair.support import SupportLost

# Low steps, which need less time.
LOW = (
    "gait={way: forward, lift_mm: 45, step_mm: 30, swing_height_mm: 30, phase_duration: 2}",
    "begin=0.5",
    "end=0.5",
)
SIZES = {spec.name: spec.size for spec in (*CHAIR.outputs, *CHAIR.truth)} | {
    "gait_time": 1,
    "done": 1,
    "hold": 1,
    "support": 4,
    "support_margin": 1,
    "payload_estimated": 3,
}


def scenario_with(*overrides):
    default = find_entry("chair-walk").default_scenario
    return load_scenario(ChairScenario, default, None, overrides)


def measured(scenario, signals):
    """Metrics of a walk with these signals, by key."""
    time = np.arange(len(signals["done"])) * 0.1
    run = Run(time, signals, {}, None, None, 1.0, None, None)
    return {metric.key: metric for metric in ChairWalk("chair-walk").measure(scenario, run)}


@pytest.fixture(scope="module")
def walked(finished):
    """Scenario and log of a walk with the paper's passenger, on bodies."""
    run = finished("chair-walk")
    return run.scenario, run.log.time, run.log.signals


def test_a_walk_with_the_papers_passenger_holds_all_bounds(finished):
    bounds = {metric.key: metric.bound for metric in finished("chair-walk").result.metrics}
    assert bounds["body_error_mm"] == 1.0
    assert bounds["tilt_deg"] == 0.1
    assert bounds["peak_force_N"] == 250.0
    assert bounds["drift_mm"] == 5.0
    assert bounds["foot_below_ground_mm"] <= 0.02


def test_feet_go_up_as_planned_and_stand_where_they_should(walked):
    _, _, signals = walked
    heights = signals["truth.foot_height"].reshape(-1, 4, 3).min(axis=2)
    assert heights.max(axis=0) == pytest.approx([0.1] * 4, abs=1e-3)
    assert heights[signals["support"] > 0.5].max() < 1e-3
    assert signals["done"][-1, 0] == 1.0


def test_payload_and_margin_are_known_from_the_currents_while_walking(walked):
    scenario, time, signals = walked
    payload = signals["payload_estimated"][time > scenario.begin]
    np.testing.assert_allclose(payload[:, 0], 57.0, rtol=0, atol=0.5)
    assert 1e3 * np.abs(payload[:, 1:]).max() < 8.0
    assert not signals["hold"].any()
    assert 0.045 < signals["support_margin"][time > scenario.begin].min() < 0.058


def test_commands_begin_at_rest(walked):
    _, time, signals = walked
    # Drives creep by a millimetre a second, which is all that is to be corrected.
    assert np.abs(signals["legs.velocity_command"][time < 0.5]).max() < 5e-3


def test_loops_are_closed_to_a_micrometre_at_the_default_step():
    # Through the lift and the first half of a swing, which is as much as loops ever bear.
    loop = ClosedLoop(CHAIR, scenario_with(*LOW, "begin=0"), log=("truth.loop_error",))
    simulator = Simulator(loop)
    simulator.AdvanceTo(3.0)
    error = loop.recording(simulator.get_context())["truth.loop_error"]
    assert 0.0 < error.max() < 1e-6


@pytest.fixture
def perfect():
    """Scenario and signals of a second of a walk in which everything is as it should be."""
    scenario = scenario_with("begin=0", "gait.way=forward")
    time = 1.0 + np.arange(10) * 0.1
    signals = {name: np.zeros((10, size)) for name, size in SIZES.items()}
    signals["done"][-1] = 1.0
    signals["support_margin"][:] = 0.05
    signals["gait_time"][:, 0] = time
    signals["truth.body_position"] = body_desired(scenario, signals)
    signals["legs.position"] = lengths_desired(scenario, signals)
    return scenario, signals


def test_loops_have_a_bound_where_the_step_is_fine(perfect):
    scenario, signals = perfect
    bounds = {}
    for step in (1e-3, 5e-3):
        scenario.plant.time_step = step
        signals["truth.loop_error"][3, 2] = 1.5e-6
        loop = measured(scenario, signals)["loop_error_um"]
        assert loop.value == pytest.approx(1.5)
        bounds[step] = loop.bound, loop.passed
    assert bounds == {1e-3: (1.0, False), 5e-3: (None, True)}


@pytest.mark.parametrize(
    ("signal", "value", "key"),
    [
        ("truth.body_position", 0.0012, "body_error_mm"),
        ("truth.body_attitude", 0.002, "tilt_deg"),
        ("truth.force", -251.0, "peak_force_N"),
        ("truth.foot_height", -3e-5, "foot_below_ground_mm"),
        ("legs.velocity", 0.081, "max_branch_speed_mm_s"),
        ("support_margin", -0.049, "support_margin_mm"),
    ],
)
def test_a_walk_that_goes_wrong_breaks_the_bound_of_what_went_wrong(perfect, signal, value, key):
    scenario, signals = perfect
    assert all(metric.passed for metric in measured(scenario, signals).values())
    signals[signal][5, 0] += value
    broken = {metric.key for metric in measured(scenario, signals).values() if not metric.passed}
    assert broken == {key}


@pytest.mark.slow
def test_the_kinematic_plant_walks_there_and_back_in_the_other_order(execute):
    way = ("gait.order=24-13", "gait.way=forward and back")
    found = execute("chair-walk", *LOW, *way, "backend=kinematic")
    assert found["drift_mm"] < 0.5
    assert found["body_error_mm"] <= 1.0


def test_a_passenger_beyond_the_margin_is_refused_in_millimetres():
    with pytest.raises(SupportLost) as caught:
        ChairWalk("chair-walk").check(scenario_with("passenger.x_mm=100", "passenger.y_mm=50"))
    text = str(caught.value)
    assert f"{1e3 * caught.value.margin:.1f} mm" in text
    assert caught.value.margin < 0.0
    assert "first swing" in text
    assert "\n" not in text


def test_a_walk_that_was_held_is_an_error_with_the_margin():
    n = 50
    signals = {
        "done": np.zeros((n, 1)),
        "hold": np.repeat((0.0, 1.0), n // 2)[:, None],
        "gait_time": np.linspace(0.0, 2.0, n)[:, None],
        "support_margin": np.full((n, 1), 0.004),
    }
    with pytest.raises(SupportLost, match=r"4\.0 mm"):
        measured(scenario_with("gait.way=forward"), signals)


def test_the_mock_walks_without_a_machine(execute, tmp_path):
    path = tmp_path / "walk.npz"
    found = execute("chair-walk", *LOW, "backend=mock", log=path)
    assert found.passed, found.broken
    assert "body_error_mm" not in found.as_json()
    log = read_log(path)
    assert log.signals["legs.position"].shape[1] == 12
    assert log.metadata["units"]["legs.current"] == "A"
    assert not [name for name in log.signals if name.startswith("truth.")]


@pytest.fixture
def panel():
    panel = Panel(Meshcat(), "the chair")
    yield panel
    panel.close()


def test_live_sliders_move_the_passenger_and_the_chair_waits(panel):
    experiment = find_entry("chair-walk").load()
    scenario = scenario_with("plant.time_step=0.005", "begin=0.2")
    chair = LiveChair(scenario, panel, experiment.read_out)
    controller = chair.loop.controller

    def rows():
        return {row["label"]: row for row in panel._state()["rows"]}

    with chair.shown():
        chair.begin()
        for _ in range(10):
            chair.advance()
        assert chair.asked().mass == 57.0
        assert chair.signal(controller, "hold") == 0.0
        assert panel._state()["state"] == "walks"
        assert rows()["passenger"]["measured"] == pytest.approx(57.0, abs=1.0)
        panel.SetSliderValue("to the right [mm]", 150.0)
        panel.SetSliderValue("ahead [mm]", 100.0)
        for _ in range(30):
            chair.advance()
        assert chair.asked().x == pytest.approx(0.15)
        assert chair.signal(controller, "hold") == 1.0
        assert panel._state()["state"] == "waits: the passenger would tip it over"
        assert panel._state()["is_alarming"]
        shown = rows()
        assert shown["to the right"]["measured"] == pytest.approx(150.0, abs=5.0)
        assert shown["ahead"]["asked"] == 100.0
        assert shown["margin"]["measured"] < shown["margin"]["asked"] == 10.0
        held = chair.signal(controller, "gait_time")
        assert held < 5.0
        panel.SetSliderValue("to the right [mm]", 0.0)
        panel.SetSliderValue("ahead [mm]", 0.0)
        for _ in range(40):
            chair.advance()
        assert chair.signal(controller, "hold") == 0.0
        assert chair.signal(controller, "gait_time") > held
    assert panel.GetSliderNames() == []


def test_the_chair_walks_on_until_told_to_stop(panel, click_after):
    scenario = scenario_with("backend=kinematic", "begin=0", "gait.way=forward")
    chair = LiveChair(scenario, panel, find_entry("chair-walk").load().read_out)
    click_after(chair, END, 0.3)
    assert chair.obey() == END
    assert 0.2 < chair.signal(chair.loop.controller, "gait_time")[0] < 0.4


def test_the_chair_walks_while_its_operator_holds_a_button(panel, monkeypatch):
    experiment = find_entry("chair-walk").load()
    scenario = scenario_with("backend=kinematic", "begin=0.2")
    loop = experiment.operated(scenario, panel)
    simulator = Simulator(loop)
    root = simulator.get_context()
    (operator,) = loop.sources
    readings = loop.readings(root, ("legs.velocity_command", "gait_time"))

    def advance(duration):
        """Simulates while a page says that the button is held, or says nothing."""
        end = root.get_time() + duration
        while root.get_time() < end:
            if held:
                panel._obey({"hold": "walk", "on": True, "number": time.monotonic_ns()})
            simulator.AdvanceTo(root.get_time() + 0.05)

    def fastest():
        return np.abs(readings["legs.velocity_command"]()).max()

    def holds(seconds):
        """Has the last word about the button, and those to come, count for so long."""
        monkeypatch.setattr("parapod.sims.lab.panel._HELD", seconds)
        if held:
            panel._obey({"hold": "walk", "on": True, "number": time.monotonic_ns()})

    held = False
    holds(60.0)  # longer than a slow computer takes for a step
    with operator.shown():
        advance(0.5)
        assert fastest() < 2e-3
        assert experiment.read_out(loop, root).state.startswith("stands; ")
        held = True
        advance(2.5)
        assert fastest() > 5e-3
        assert experiment.read_out(loop, root).state == "walks"
        holds(0.25)
        held = False  # the page is gone
        time.sleep(0.26)
        advance(0.2)
        assert fastest() < 2e-3
        stood = readings["gait_time"]()
        advance(1.0)
        assert readings["gait_time"]() == stood
        holds(60.0)
        held = True
        advance(1.0)
        assert readings["gait_time"]() > stood
