"""The job `level`: short runs of it, its files, its refusals, and the sliders after it."""

import _thread
import asyncio
import io
import json
import re
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import umsgpack
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from rich.console import Console
from tornado.websocket import websocket_connect

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario, WaypointScenario
from parapod.sims.cli.main import main
from parapod.sims.lab.bench import RESTART, STOP
from parapod.sims.lab.experiment import ENTRIES, RunOptions
from parapod.sims.lab.files import read_log
from parapod.sims.levelling_platform.level import EXPERIMENT, run
from parapod.sims.levelling_platform.levelling import LivePlatform, check_job, stay_live
from parapod.systems.core.errors import OutputError, ScenarioError, UnreachablePosture
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.kinematics import height_range
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.sliders import PostureSliders

DEFAULT = Path(str(files("parapod.sims.scenarios"))) / "level.yaml"
KEYS = {
    "ground_roll_error_deg",
    "ground_pitch_error_deg",
    "roll_error_deg",
    "pitch_error_deg",
    "height_error_mm",
    "settling_time_s",
    "attitude_estimate_error_deg",
    "peak_voltage_V",
    "passive_leg_lift_mm",
    "active_leg_lift_mm",
    "posture_scale",
    "realtime_factor",
}
# As little as passes for a job: ground that is almost level, found out by perfect sensors.
BRIEF = (
    "backend=kinematic",
    "ground.roll_deg=0.3",
    "ground.pitch_deg=0.2",
    "sensors={encoder_resolution_mm: 0, imu_noise: false, accel_bias_mg: 0, gyro_bias_deg_s: 0}",
    "job.initial_extension_mm=405",
    "job.estimate_at=1.5",
    "job.settled_after=1.5",
    "job.waypoints=[]",
    "job.arm={start: 0.5, duration: 0.5}",
    "job.end=2",
)
# The multibody plant's job without its pauses.
SHORT = (
    "job.settled_after=3.5",
    "job.waypoints=[{time: 3.5, roll_deg: -0.7, pitch_deg: 0.7, height_mm: -10}]",
    "job.arm={start: 5.5}",
    "job.end=7",
)


def scenario_with(*overrides):
    return load_scenario(LevellingScenario, DEFAULT, None, overrides)


@pytest.fixture
def options():
    return RunOptions(console=Console(file=io.StringIO()))


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


def values(result):
    """Metrics of a result, without the one that says how fast the computer is."""
    return {m.key: m.value for m in result.metrics if m.key != "realtime_factor"}


def test_the_experiment_is_listed_as_it_describes_itself():
    (entry,) = [entry for entry in ENTRIES if entry.name == EXPERIMENT.name]
    assert entry.load() is EXPERIMENT
    assert entry.summary == EXPERIMENT.summary


@pytest.mark.parametrize("seed", [0, 1])
def test_the_default_job_holds_its_bounds_on_the_kinematic_backend(options, seed):
    result = run(scenario_with("backend=kinematic", f"seed={seed}"), options)
    assert result.broken == ()
    assert set(values(result)) | {"realtime_factor"} == KEYS
    assert result.notes == ()


@pytest.mark.parametrize("leg_model", ["full", "reduced"])
def test_a_short_job_holds_its_bounds_on_the_multibody_backend(options, leg_model):
    result = run(scenario_with(*SHORT, f"plant.leg_model={leg_model}"), options)
    assert result.broken == ()
    closure = {"closure_error_um"} if leg_model == "full" else set()
    assert set(values(result)) | {"realtime_factor"} == KEYS | closure


def test_without_imperfections_the_errors_are_those_of_the_method(options):
    perfect = ("actuators.gain_error=0", "job.estimate_at=1.5", *BRIEF[3:4])
    result = values(run(scenario_with(*SHORT, *perfect), options))
    assert result["roll_error_deg"] < 0.02
    assert result["pitch_error_deg"] < 0.02
    assert result["height_error_mm"] < 0.3
    assert result["ground_roll_error_deg"] < 0.01
    assert result["ground_pitch_error_deg"] < 0.01


def test_the_accelerometer_s_bias_tilts_the_platform_by_as_much(options):
    overrides = (*BRIEF, "sensors.accel_bias_mg=10", "job.estimate_at=3", "job.arm.angle_deg=0")
    result = values(run(scenario_with(*overrides), options))
    tilt = np.degrees(np.arcsin(0.01))
    # A turn-on bias of the sample reaches ground and platform alike.
    assert result["ground_roll_error_deg"] == pytest.approx(tilt, rel=0.05)
    assert result["roll_error_deg"] == pytest.approx(tilt, rel=0.05)


def test_the_same_seed_gives_the_same_result_and_another_does_not(options):
    noisy = [o for o in BRIEF if not o.startswith("sensors")]
    first, again, other = (
        values(run(scenario_with(*noisy, f"seed={seed}"), options)) for seed in (5, 5, 6)
    )
    assert first == again
    assert first != other


def test_watching_and_recording_change_no_number(options, tmp_path):
    watched = replace(options, html=tmp_path / "a.html", log=tmp_path / "a.npz")
    scenario = scenario_with(*BRIEF)
    assert values(run(scenario, options)) == values(run(scenario, watched))


@pytest.mark.parametrize("backend", ["kinematic", "multibody"])
def test_ground_too_steep_is_refused_with_leg_and_missing_stroke(options, backend):
    steep = ("ground.roll_deg=3", "ground.pitch_deg=5", "job.estimate_at=1.5")
    with pytest.raises(UnreachablePosture) as refused:
        run(scenario_with(*steep, f"backend={backend}"), options)
    assert refused.value.leg in (1, 3)
    assert 1e3 * refused.value.missing == pytest.approx(0.85, abs=0.3)
    text = str(refused.value)
    assert "\n" not in text
    assert f"leg {refused.value.leg} would need" in text
    assert f"{1e3 * refused.value.missing:.2f} mm outside its stroke" in text


def test_ground_too_steep_is_refused_before_anything_moves():
    steep = ("ground.roll_deg=3", "ground.pitch_deg=5", "job.estimate_at=1.5")
    loop = ClosedLoop(PLATFORM, scenario_with("backend=kinematic", *steep))
    simulator = Simulator(loop)
    loop.reset(simulator.get_mutable_context())
    with pytest.raises(UnreachablePosture):
        simulator.AdvanceTo(10.0)
    time, signals = loop.recorded(simulator.get_context())
    assert time[-1] == pytest.approx(1.5, abs=0.03)
    assert np.ptp(signals["truth.extension"], axis=0) == pytest.approx(0.0, abs=1e-9)
    assert np.abs(signals["legs.voltage"]).max() < 0.2


def test_waypoints_that_had_to_shrink_are_reported(options):
    little = ("ground.roll_deg=3", "ground.pitch_deg=4", "backend=kinematic")
    result = run(scenario_with(*little), options)
    assert result.broken == ()
    share = values(result)["posture_scale"]
    assert 0.0 < share < 1.0
    (note,) = result.notes
    assert note.startswith(f"waypoints scaled to {100 * share:.0f} %: ")
    assert re.search(r"leaves leg \d only \d\.\d mm of stroke$", note)


def test_a_platform_that_never_gets_level_has_no_settling_time(options):
    scenario = scenario_with(*BRIEF, "control.voltage_limit=0.5", "actuators.coulomb_friction=2e4")
    result = run(scenario, options)
    assert values(result)["settling_time_s"] == np.inf
    assert "settling_time_s" in [metric.key for metric in result.broken]
    assert result.as_json()["settling_time_s"] is None


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("job.end=20", "job.end"),
        ("job.end=26", "job.end"),
        ("job.settled_after=8", "job.waypoints.0.time"),
        ("job.waypoints.1.time=6.5", "job.waypoints.1.time"),
        ("plant.time_step=0.02", "control.period"),
    ],
)
def test_scenarios_that_contradict_themselves_are_refused_by_key(override, key):
    scenario = scenario_with(override)
    with pytest.raises(ScenarioError, match=re.escape(key)) as refused:
        check_job(scenario)
    assert refused.value.key == key


def test_a_job_may_have_no_waypoints(options):
    scenario = scenario_with(*BRIEF)
    assert scenario.job.waypoints == []
    assert run(scenario, options).broken == ()


def test_the_recording_is_self_contained(options, tmp_path):
    path = tmp_path / "level.html"
    run(scenario_with(*BRIEF), replace(options, html=path))
    html = path.read_text()
    assert not re.search(r"<script[^>]*\bsrc=", html)
    assert not re.search(r"<link[^>]*\bhref=\"(?!data:)", html)
    assert len(html) > 1e6
    assert list(tmp_path.iterdir()) == [path]


def test_the_log_of_a_run_with_faults_has_them_too(options, tmp_path):
    path = tmp_path / "level.npz"
    fault = "faults=[{at: 1.0, target: legs.extension, index: 2, kind: stuck}]"
    run(scenario_with("backend=kinematic", *SHORT, fault), replace(options, log=path))
    log = read_log(path)
    assert log.signals["fault.legs.extension.changed"][-1] == 1.0
    units = log.metadata["units"]
    assert units["fault.legs.extension.extra_age"] == "s"
    assert set(units) == set(log.signals)


def test_the_log_is_readable_by_numpy_alone(options, tmp_path):
    path = tmp_path / "level.npz"
    scenario = scenario_with(*BRIEF)
    run(scenario, replace(options, log=path))
    with np.load(path, allow_pickle=False) as log:
        metadata = json.loads(str(log["metadata"]))
        names = set(log.files) - {"t", "metadata"}
        assert set(metadata["units"]) == names
        assert {"truth.posture", "legs.voltage", "imu.accel", "posture_command"} <= names
        assert log["t"][-1] == pytest.approx(3.5)
        assert log["truth.posture"].shape == (log["t"].size, 3)
        np.testing.assert_allclose(log["truth.posture"][-1, 2], 0.477, atol=1e-3)
    (tmp_path / "again.yaml").write_text(metadata["scenario"])
    again = load_scenario(LevellingScenario, tmp_path / "again.yaml")
    assert again == scenario


@pytest.mark.parametrize("suffix", [".dot", ".gv"])
def test_the_diagram_is_written_as_graphviz_text(options, tmp_path, suffix):
    path = tmp_path / f"level{suffix}"
    run(scenario_with(*BRIEF), replace(options, graphviz=path))
    text = path.read_text()
    assert text.startswith("digraph")
    assert "posture_reference" in text


def test_a_picture_of_the_diagram_needs_graphviz(options, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(OutputError, match=r"'dot' of Graphviz"):
        run(scenario_with(*BRIEF), replace(options, graphviz=tmp_path / "level.svg"))


def test_a_diagram_of_unknown_format_is_refused(options, tmp_path):
    with pytest.raises(OutputError, match=r"\.dot, \.gv, \.svg, \.png, \.pdf"):
        run(scenario_with(*BRIEF), replace(options, graphviz=tmp_path / "level.xyz"))
    assert list(tmp_path.iterdir()) == []


def test_the_command_runs_it(tmp_path, capsys):
    path = tmp_path / "level.json"
    assert main(["run", "level", "--set", *BRIEF, "--json", str(path)]) == 0
    assert "all bounds held: 10 of 10" in capsys.readouterr().out
    data = json.loads(path.read_text())
    assert (data["experiment"], data["backend"], data["seed"]) == ("level", "kinematic", 0)
    assert data["passed"] is True
    assert set(data) >= KEYS


def test_the_command_refuses_ground_too_steep_in_one_line(capsys):
    steep = ("ground.roll_deg=3", "ground.pitch_deg=5", "job.estimate_at=1.5")
    assert main(["run", "level", "--backend", "kinematic", "--set", *steep]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r"parapod: error: leg \d would need .*mm outside its stroke .*\n", err)


def test_sliders_are_there_only_while_they_are_shown(meshcat, read):
    sliders = PostureSliders(meshcat, height=0.45)
    context = sliders.CreateDefaultContext()
    assert meshcat.GetSliderNames() == []
    with sliders.shown():
        assert set(meshcat.GetSliderNames()) == {"roll [deg]", "pitch [deg]", "height [mm]"}
    assert meshcat.GetSliderNames() == []
    assert read(sliders, context) == {"posture_command": pytest.approx([0.0, 0.0, 0.45])}


def test_sliders_command_what_they_show_and_the_last_command_outlives_them(meshcat, read):
    sliders = PostureSliders(meshcat)
    simulator = Simulator(sliders)
    with sliders.shown():
        meshcat.SetSliderValue(PostureSliders.ROLL, 2.0)
        meshcat.SetSliderValue(PostureSliders.PITCH, -1.5)
        meshcat.SetSliderValue(PostureSliders.HEIGHT, 500.0)
        simulator.AdvanceTo(0.06)
    simulator.AdvanceTo(0.2)
    command = read(sliders, simulator.get_context())["posture_command"]
    np.testing.assert_allclose(command, [np.radians(2.0), np.radians(-1.5), 0.5], atol=1e-9)


def test_sliders_move_the_levelled_platform(meshcat, options):
    platform = LivePlatform(scenario_with(*BRIEF), meshcat)
    for _ in range(2):  # The second time after a restart.
        platform.level(options.console)
        np.testing.assert_allclose(platform.posture, [0.0, 0.0, 0.477], atol=1e-3)
        with platform.sliders.shown():
            meshcat.SetSliderValue(PostureSliders.ROLL, 1.5)
            meshcat.SetSliderValue(PostureSliders.HEIGHT, 485.0)
            platform.advance(4.0)
        np.testing.assert_allclose(platform.posture, [np.radians(1.5), 0.0, 0.485], atol=1e-3)


def test_sliders_beyond_the_stroke_move_the_platform_as_far_as_it_goes(meshcat, options):
    platform = LivePlatform(scenario_with(*BRIEF), meshcat)
    platform.level(options.console)
    with platform.sliders.shown():
        meshcat.SetSliderValue(PostureSliders.ROLL, 7.0)
        meshcat.SetSliderValue(PostureSliders.HEIGHT, 560.0)
        platform.advance(12.0)
    roll, pitch, height = platform.posture
    assert roll == pytest.approx(np.radians(7.0), abs=2e-3)
    _, highest = height_range(
        MODEL_GEOMETRY, (roll, pitch), scenario_with(*BRIEF).ground.inclination
    )
    assert height == pytest.approx(highest, abs=1e-3)
    assert highest < 0.55


def test_restart_runs_the_job_again_and_stop_ends(meshcat, options):
    jobs = []
    ended = threading.Event()

    async def click(address):
        # As a browser does it, in a thread of its own: Meshcat itself may not be called there.
        browser = await websocket_connect(address)
        for _ in range(40):
            if ended.is_set():
                break
            button = {"type": "button", "name": STOP if jobs else RESTART}
            await browser.write_message(umsgpack.packb(button), binary=True)
            await asyncio.sleep(0.5)
        else:
            _thread.interrupt_main()
        browser.close()

    thread = threading.Thread(target=lambda url=meshcat.ws_url(): asyncio.run(click(url)))
    thread.start()
    stay_live(scenario_with(*BRIEF), meshcat, options.console, lambda: jobs.append(1))
    ended.set()
    thread.join()
    assert jobs == [1]
    assert meshcat.GetButtonNames() == []
    assert meshcat.GetSliderNames() == []
    assert options.console.file.getvalue().count("sliders in the browser") == 1


def test_ctrl_c_in_the_live_phase_ends_with_the_job_s_exit_code(tmp_path):
    # SIGINT is ignored by children of shells without job control, hence the default handler.
    start = "import signal,sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
    start += "from parapod.sims.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", start, "run", "level", "--meshcat", "--set", *BRIEF]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        said = ""
        while "Ctrl-C" not in said:
            line = process.stderr.readline()
            assert line, said
            said += line
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    assert "all bounds held" in out
    assert "http://localhost:" in said


def test_waypoints_are_taken_relative_to_the_level_posture(options, tmp_path):
    scenario = scenario_with(*BRIEF)
    scenario.job.waypoints = [WaypointScenario(1.5, 0.5, -0.5, 5.0)]
    scenario.job.end = 3.5
    run(scenario, replace(options, log=tmp_path / "level.npz"))
    with np.load(tmp_path / "level.npz") as log:
        last = log["truth.posture"][-1]
    np.testing.assert_allclose(last, [np.radians(0.5), np.radians(-0.5), 0.482], atol=5e-4)
