"""Sliders in the browser, with which a viewer moves the platform once the job is over."""

import _thread
import asyncio
import io
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import umsgpack
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from rich.console import Console
from tornado.websocket import websocket_connect

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.lab.bench import RESTART, STOP
from parapod.sims.levelling_platform.levelling import LivePlatform, stay_live
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.kinematics import height_range
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.sliders import PostureSliders

BRIEF = (
    "backend=kinematic",
    "ground={roll_deg: 0.3, pitch_deg: 0.2}",
    "sensors={encoder_resolution_mm: 0, imu_noise: false, accel_bias_mg: 0, gyro_bias_deg_s: 0}",
    "job={initial_extension_mm: 405, estimate_at: 1.5, settled_after: 1.5, waypoints: [], end: 2}",
    "job.arm={start: 0.5, duration: 0.5}",
)


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


@pytest.fixture
def console():
    return Console(file=io.StringIO())


def brief():
    return load_scenario(LevellingScenario, overrides=BRIEF)


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


def test_sliders_move_the_levelled_platform(meshcat, console):
    platform = LivePlatform(brief(), meshcat)
    for _ in range(2):  # The second time after a restart.
        platform.level(console)
        np.testing.assert_allclose(platform.posture, [0.0, 0.0, 0.477], atol=1e-3)
        with platform.sliders.shown():
            meshcat.SetSliderValue(PostureSliders.ROLL, 1.5)
            meshcat.SetSliderValue(PostureSliders.HEIGHT, 485.0)
            platform.advance(4.0)
        np.testing.assert_allclose(platform.posture, [np.radians(1.5), 0.0, 0.485], atol=1e-3)


def test_sliders_beyond_the_stroke_move_the_platform_as_far_as_it_goes(meshcat, console):
    platform = LivePlatform(brief(), meshcat)
    platform.level(console)
    with platform.sliders.shown():
        meshcat.SetSliderValue(PostureSliders.ROLL, 7.0)
        meshcat.SetSliderValue(PostureSliders.HEIGHT, 560.0)
        platform.advance(12.0)
    roll, pitch, height = platform.posture
    assert roll == pytest.approx(np.radians(7.0), abs=2e-3)
    _, highest = height_range(MODEL_GEOMETRY, (roll, pitch), brief().ground.inclination)
    assert height == pytest.approx(highest, abs=1e-3)
    assert highest < 0.55


def test_restart_runs_the_job_again_and_stop_ends(meshcat, console):
    jobs = []
    ended = threading.Event()

    async def click(address):
        # As a browser does it, in a thread of its own: Meshcat itself may not be called there.
        browser = await websocket_connect(address)
        for _ in range(120):
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
    stay_live(brief(), meshcat, console, lambda: jobs.append(1))
    ended.set()
    thread.join()
    assert jobs == [1]
    assert meshcat.GetButtonNames() == []
    assert meshcat.GetSliderNames() == []
    assert console.file.getvalue().count("sliders in the browser") == 1


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
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    assert "all bounds held" in out
    assert "http://localhost:" in said
