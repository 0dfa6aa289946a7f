"""The page with which a viewer moves the platform once the job is over."""

import io
import signal
import subprocess
import sys
import threading
import time
from itertools import pairwise

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from rich.console import Console

from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.lab.discovery import find_entry
from parapod.sims.lab.panel import Panel
from parapod.sims.lab.runner import END, RESTART, Live, stay_live
from parapod.sims.levelling_platform.deploy import DeployScenario
from parapod.sims.levelling_platform.levelling import LivePlatform, read_posture
from parapod.sims.levelling_platform.operation import operated_platform, read_operation
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.kinematics import height_range, inverse_kinematics
from parapod.systems.levelling_platform.sliders import (
    OperatorControls,
    PostureSliders,
    posture_ranges,
)
from parapod.systems.levelling_platform.supervisor import Command, Phase

BRIEF = (
    "backend=kinematic",
    "ground={roll_deg: 0.3, pitch_deg: 0.2}",
    "machine.sensors={encoder_resolution_mm: 0, imu_noise: false, accel_bias_mg: 0, "
    "gyro_bias_deg_s: 0}",
    "job={initial_extension_mm: 405, estimate_at: 1.5, settled_after: 1.5, waypoints: [], end: 2}",
    "job.arm={start: 0.5, duration: 0.5}",
)
ROLL, PITCH, HEIGHT = PostureSliders.ROLL, PostureSliders.PITCH, PostureSliders.HEIGHT


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


@pytest.fixture
def panel(meshcat):
    panel = Panel(meshcat, "the platform")
    yield panel
    panel.close()


@pytest.fixture
def page(panel):
    """Somebody who looks at the page: `there` until it is cleared."""
    there, over = threading.Event(), threading.Event()
    there.set()

    def speak():
        while not over.wait(0.02):
            if there.is_set():
                panel._beat("")

    panel._beat("")
    thread = threading.Thread(target=speak)
    thread.start()
    yield there
    over.set()
    thread.join()


@pytest.fixture
def console():
    return Console(file=io.StringIO())


def brief(*more):
    return load_scenario(LevellingScenario, overrides=(*BRIEF, *more))


@pytest.fixture
def platform(panel, console):
    """The platform, levelled, with its sliders shown."""
    platform = LivePlatform(brief(), panel, read_posture)
    platform.level(console)
    with platform.shown():
        yield platform


# Sliders


@pytest.mark.parametrize("make", [lambda meshcat: meshcat, lambda meshcat: Panel(meshcat, "x")])
def test_sliders_of_meshcat_and_of_the_page_command_what_they_show(make, meshcat, read):
    controls = make(meshcat)
    sliders = PostureSliders(controls, height=0.45)
    simulator = Simulator(sliders)
    assert controls.GetSliderNames() == []
    with sliders.shown():
        assert set(controls.GetSliderNames()) == {"roll [deg]", "pitch [deg]", "height [mm]"}
        assert read(sliders, simulator.get_context())["posture_command"][2] == 0.45
        controls.SetSliderValue(ROLL, 2.0)
        controls.SetSliderValue(PITCH, -1.5)
        controls.SetSliderValue(HEIGHT, 500.0)
        simulator.AdvanceTo(0.06)
    assert controls.GetSliderNames() == []
    simulator.AdvanceTo(0.2)  # the last command outlives them
    command = read(sliders, simulator.get_context())["posture_command"]
    np.testing.assert_allclose(command, [np.radians(2.0), np.radians(-1.5), 0.5], atol=1e-9)


@pytest.mark.parametrize("ground", [(0.0, 0.0), (2.0, 3.0), (-1.0, 4.0)])
@pytest.mark.parametrize("posture", [(0.0, 0.0, 0.477), (1.0, 2.0, 0.47), (0.5, -0.5, 0.49)])
def test_a_slider_ends_where_the_legs_do_while_the_others_stay(ground, posture):
    ground, posture = np.radians(ground), np.array([*np.radians(posture[:2]), posture[2]])
    ranges = posture_ranges(DRAWN, posture, ground)

    def is_reached(axis, value):
        changed = posture.copy()
        changed[axis] = value
        return np.isfinite(inverse_kinematics(DRAWN, changed, ground, on_unreachable="nan")).all()

    for axis, step in enumerate((np.radians(0.1), np.radians(0.1), 1e-3)):
        low, high = ranges[axis]
        assert low <= posture[axis] <= high
        assert all(is_reached(axis, value) for value in np.linspace(low, high, 9))
        largest = np.radians(7.0) if axis < 2 else np.inf
        for end, way in ((low, -step), (high, step)):
            assert not is_reached(axis, end + 1.01 * way) or abs(end) > largest - 1e-9


def test_a_posture_out_of_reach_has_no_ranges():
    assert posture_ranges(DRAWN, (0.0, np.radians(-4.0), 0.47), (0.03, 0.05)) is None


def test_sliders_move_the_platform_by_one_axis_at_a_time(platform, panel, console):
    for _ in range(2):  # the second time after a restart
        np.testing.assert_allclose(platform.posture, [0.0, 0.0, 0.477], atol=1e-3)
        panel.SetSliderValue(ROLL, 1.5)
        panel.SetSliderValue(HEIGHT, 485.0)
        platform.advance(4.0)
        np.testing.assert_allclose(platform.posture, [np.radians(1.5), 0.0, 0.485], atol=1e-3)
        panel.SetSliderValue(ROLL, 0.0)
        panel.SetSliderValue(HEIGHT, 477.0)
        platform.level(console)


def test_a_slider_at_its_end_leaves_the_other_axes_where_they_are(platform, panel):
    panel.SetSliderValue(HEIGHT, 505.0)
    platform.advance(0.2)
    assert 2.0 < panel.SetSliderValue(ROLL, 7.0) < 6.5
    platform.advance(9.0)
    asked = np.radians(panel.GetSliderValue(ROLL))
    np.testing.assert_allclose(platform.posture, [asked, 0.0, 0.505], atol=1e-3)
    _, highest = height_range(DRAWN, (asked, 0.0), brief().ground.inclination)
    assert panel.SetSliderValue(HEIGHT, 570.0) == pytest.approx(1e3 * highest, abs=1.5)


# The page's numbers


def test_the_page_tells_what_is_asked_measured_and_true(platform, panel):
    panel.SetSliderValue(ROLL, 1.0)
    platform.advance(0.2)
    assert read(platform).state == "moving"
    platform.advance(4.0)
    shown = read(platform)
    assert shown.state == "at rest, 1.00 deg from level"
    rows = {row.label: row for row in shown.rows}
    for row, asked, tolerance in (("roll", 1.0, 0.05), ("pitch", 0.0, 0.05), ("height", 477, 0.5)):
        assert rows[row].asked == pytest.approx(asked)
        assert rows[row].measured == pytest.approx(asked, abs=tolerance)
        assert rows[row].true == pytest.approx(asked, abs=tolerance)
    assert rows["ground's roll"].measured == pytest.approx(0.3, abs=0.02)
    assert rows["ground's pitch"].measured == pytest.approx(0.2, abs=0.02)
    state = panel._state()
    assert state["state"] == shown.state


def read(platform):
    return read_posture(platform.loop, platform.simulator.get_context())


def test_the_page_says_that_the_ground_is_not_known_and_that_a_command_is_clamped(
    meshcat, console
):
    platform = LivePlatform(brief(), Panel(meshcat, "x"), read_posture)
    platform.begin()
    assert read(platform).state == "waiting for the estimate of the ground"
    assert {row.label: row for row in read(platform).rows}["height"].measured is None
    platform.level(console)
    with platform.shown():
        # Both at once: neither slider knows yet of the other.
        platform.panel.SetSliderValue(ROLL, 7.0)
        platform.panel.SetSliderValue(PITCH, 7.0)
        platform.advance(0.1)
        assert read(platform).state.startswith("clamped: ")


def test_the_height_is_told_above_the_feet_s_mean(meshcat, console):
    scenario = brief("ground.foot_heights_mm=[6, 0, 2, 4]")
    platform = LivePlatform(scenario, Panel(meshcat, "x"), read_posture)
    platform.level(console)
    rows = {row.label: row for row in read(platform).rows}
    assert rows["height"].true == pytest.approx(477.0, abs=0.5)


def test_a_run_that_is_shown_tells_its_numbers_ten_times_a_second(execute, monkeypatch):
    shown = []
    monkeypatch.setattr(Panel, "show", lambda panel, readout: shown.append(readout))
    execute("level", *BRIEF, meshcat=True, live=False)
    states = [readout.state for readout in shown]
    assert states[0] == "waiting for the estimate of the ground"
    assert "moving" in states
    times = [readout.rows[-1].measured for readout in shown]
    assert times[0] == 0.0
    assert times[-1] == pytest.approx(3.5, abs=0.1)
    assert max(b - a for a, b in pairwise(times)) < 0.15


# Buttons


def test_restart_begins_anew_and_end_ends_and_closes_the_page(panel, console):
    clicks = []

    def live():
        clicks.append(RESTART if len(clicks) < 2 else END)
        return clicks[-1]

    stay_live(panel, live, console, "Do this.")
    assert clicks == [RESTART, RESTART, END]
    assert console.file.getvalue().startswith("Do this. 'Restart' begins anew")


def test_the_platform_goes_on_until_a_button_is_clicked(platform, panel, click_after):
    before = platform.simulator.get_context().get_time()
    click_after(platform, END, 0.2)
    assert platform.go_on() == END
    assert platform.simulator.get_context().get_time() == pytest.approx(before + 0.2, abs=0.05)
    assert panel.GetButtonNames() == []


# The operator


def test_an_operator_s_click_is_a_command_for_a_moment(panel):
    operator = OperatorControls(panel)
    simulator = Simulator(operator)
    operator.GetInputPort("ground_valid").FixValue(simulator.get_mutable_context(), 0.0)

    def output(name):
        return operator.GetOutputPort(name).Eval(simulator.get_context())

    def command():
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.06)
        return Command(int(output("operator")[0]))

    with operator.shown():
        assert command() is Command.NONE
        for button, meant in zip(OperatorControls.BUTTONS, list(Command)[1:], strict=True):
            panel._obey({"button": button})
            assert command() is meant
            for _ in range(4):
                last = command()
            assert last is Command.NONE
        for button in ("Go", "Stop"):
            panel._obey({"button": button})
        assert command() is Command.STOP
        panel.SetSliderValue("turntable [deg]", -20.0)
        panel.SetSliderValue("arm [deg]", 30.0)
        hold(panel, "ahead", "left", "leg 1 up", "leg 3 down")
        command()
        np.testing.assert_allclose(output("drive_request"), [0.3, np.radians(10.0)])
        np.testing.assert_allclose(output("jog_request"), [0.002, 0.0, -0.002, 0.0])
        np.testing.assert_allclose(output("arm_request"), np.radians([-20.0, 30.0]))
        hold(panel, "back", "right", "leg 3 up")
        command()
        assert not output("drive_request").any()  # both ways at once
        np.testing.assert_allclose(output("jog_request"), [0.002, 0.0, 0.0, 0.0])
        hold(panel, *[name for name in panel.GetHoldNames() if name != "ahead"], on=False)
        command()
        np.testing.assert_allclose(output("drive_request"), [0.3, 0.0])
        assert not output("jog_request").any()
        for _ in range(4):
            command()
    assert panel.GetHoldNames() == []
    assert command() is Command.NONE
    assert not output("drive_request").any()  # nothing drives without controls
    np.testing.assert_allclose(output("arm_request"), np.radians([-20.0, 30.0]))


def test_controls_without_buttons_to_hold_drive_by_sliders(meshcat):
    operator = OperatorControls(meshcat)
    simulator = Simulator(operator)
    operator.GetInputPort("ground_valid").FixValue(simulator.get_mutable_context(), 0.0)
    with operator.shown():
        meshcat.SetSliderValue("drive [m/s]", 0.3)
        meshcat.SetSliderValue("turn [deg/s]", 10.0)
        simulator.AdvanceTo(0.06)
        outputs = {
            name: operator.GetOutputPort(name).Eval(simulator.get_context())
            for name in ("drive_request", "jog_request", "operator_age")
        }
    np.testing.assert_allclose(outputs["drive_request"], [0.3, np.radians(10.0)])
    assert not outputs["jog_request"].any()
    assert outputs["operator_age"] == 0.0


@pytest.fixture
def held_until_let_go(monkeypatch):
    """Keeps buttons held until they are let go, however slow a busy computer is."""
    monkeypatch.setattr("parapod.sims.lab.panel._HELD", 60.0)


@pytest.mark.usefixtures("held_until_let_go")
def test_a_platform_whose_operator_is_gone_holds_until_somebody_resets_it(panel, page, judge):
    scenario = load_scenario(DeployScenario, overrides=("backend=kinematic",))
    loop = operated_platform(scenario.levelling, 0.47, panel, panel.meshcat)
    live = Live(panel, loop, read_operation)
    live.begin()

    def phase():
        return Phase(int(live.signal(live.loop.controller, "phase")[0]))

    with live.shown():
        live.advance(0.5)
        panel._obey({"button": "Go"})
        live.advance(2.0)
        assert phase() is Phase.LOWER
        page.clear()
        begun = time.monotonic()
        with judge() as judged:
            while phase() is Phase.LOWER and time.monotonic() < begun + 60.0:
                live.advance(0.05)
                time.sleep(0.01)
        assert phase() is Phase.FAULT
        live.advance(1.0)
        stood = live.signal(live.loop.station, "truth.extension")
        live.advance(2.0)
        np.testing.assert_allclose(
            live.signal(live.loop.station, "truth.extension"), stood, atol=2e-5
        )
        assert any("operator_lost" in text for text in panel._state()["remarks"])
        page.set()
        while panel.silence() > 0.1:
            time.sleep(1e-3)
        live.advance(1.0)
        assert phase() is Phase.FAULT
        panel._obey({"button": "Reset"})
        live.advance(1.0)
        assert phase() is Phase.STANDBY
        hold(panel, "leg 2 down")
        live.advance(0.5)
        hold(panel, "leg 2 down", on=False)
        jogged = live.signal(live.loop.station, "legs.extension") - stood
        assert jogged[1] < -5e-4
        assert np.abs(np.delete(jogged, 1)).max() < 5e-5
        panel._obey({"button": "Stop"})
        live.advance(0.5)
        assert phase() is Phase.RETRACT
    judged.check(0.5)


def hold(panel, *names, on=True):
    """Presses buttons, or lets them go."""
    for name in names:
        assert panel._obey({"hold": name, "on": on, "number": time.monotonic_ns()})


@pytest.mark.usefixtures("held_until_let_go")
def test_a_person_operates_the_platform(panel, page, monkeypatch):
    monkeypatch.setattr(panel, "silence", lambda: 0.0)  # whatever a busy computer delays
    overrides = ("backend=kinematic", "ground.foot_heights_mm=[0, 0, 0, 0]")
    scenario = load_scenario(DeployScenario, overrides=overrides)
    loop = operated_platform(scenario.levelling, 0.47, panel, panel.meshcat)
    live = Live(panel, loop, read_operation)
    live.begin()

    def until(phase, longest=30.0):
        while Phase(int(live.signal(live.loop.controller, "phase")[0])) is not phase:
            live.advance()
            assert live.simulator.get_context().get_time() < longest

    with live.shown():
        hold(panel, "ahead")
        live.advance(1.0)
        shown = panel._state()
        assert shown["state"] == "transport"
        assert [row["label"] for row in shown["rows"]] == ["time"]  # on wheels there is no margin
        assert set(shown["idle"]) == {"Reset", "arm [deg]", "turntable [deg]"}
        assert live.signal(live.loop.station, "wheels.velocity").mean() > 0.5
        hold(panel, "ahead", on=False)
        live.advance(1.0)
        panel._obey({"button": "Go"})
        until(Phase.HOLD)
        live.advance(0.2)
        shown = panel._state()
        rows = {row["label"]: row for row in shown["rows"]}
        assert {*panel.GetHoldNames(), "Go", "Reset"} == set(shown["idle"])
        assert rows["height"]["true"] == pytest.approx(470.0, abs=2.0)
        assert rows["margin"]["measured"] > rows["margin"]["asked"]
        panel.SetSliderValue("arm [deg]", 90.0)
        panel.SetSliderValue("turntable [deg]", 90.0)
        live.advance(1.0)
        panel._obey({"button": "Stop"})
        live.advance(0.5)
        assert panel._state()["state"] != "hold" or panel._state()["remarks"]
        panel.SetSliderValue("arm [deg]", 0.0)
        panel.SetSliderValue("turntable [deg]", 0.0)
        until(Phase.TRANSPORT, 60.0)


@pytest.mark.parametrize("name", ["level", "deploy", "chair-walk", "centre-walk", "bench-walk"])
def test_what_can_be_moved_after_the_run_is_moved_on_its_page(name, panel):
    entry = find_entry(name)
    experiment = entry.load()
    scenario = load_scenario(experiment.schema, entry.default_scenario)
    assert experiment.live(scenario, panel, None, Console(quiet=True)) is not None


@pytest.mark.slow
def test_ctrl_c_in_the_live_phase_ends_with_the_job_s_exit_code():
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
        out, err = process.communicate(timeout=600)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    assert "all bounds held" in out
    assert "http://localhost:" in said
