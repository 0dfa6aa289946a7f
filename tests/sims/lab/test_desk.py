"""The operator's page in a process of its own, seen from the program that drives the machine."""

import json
import os
import signal
import time
import urllib.request

import numpy as np
import pytest
from pydrake.geometry import Meshcat

from parapod.diagrams.levelling_platform.view import PlatformTwin
from parapod.sims.lab.desk import Desk
from parapod.sims.lab.panel import Readout, Row
from parapod.sims.levelling_platform.deploy import DeployScenario
from parapod.systems.core.errors import OutputError
from tests.conftest import standing_still

SIGNALS = {
    "legs.extension": np.full(4, 0.405),
    "attitude_estimated": np.zeros(2),
    "ground_valid": np.zeros(1),
    "ground_estimated": np.zeros(2),
}


@pytest.fixture(scope="module")
def shared():
    with Desk("deploy", DeployScenario(), "a title") as desk:
        yield desk


@pytest.fixture
def desk(shared):
    """A desk without controls."""
    yield shared
    for name in shared.GetSliderNames():
        shared.DeleteSlider(name)
    shared.DeleteButton("Go", strict=False)
    shared.DeleteHold("ahead", strict=False)


def until(condition, timeout=60.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def state(desk):
    with urllib.request.urlopen(desk.web_url().replace("/?", "/state?"), timeout=60.0) as answer:
        return json.loads(answer.read())


def send(desk, **body):
    data, headers = json.dumps(body).encode(), {"Origin": desk.web_url().partition("/?")[0]}
    request = urllib.request.Request(desk.web_url(), data, headers)
    urllib.request.urlopen(request, timeout=60.0).close()


def test_it_shows_controls_and_hears_of_them(desk):
    desk.AddSlider("height [mm]", 390.0, 570.0, 1.0, 477.0)
    desk.AddButton("Go")
    desk.AddHold("ahead", "ArrowUp")
    desk.SetSliderRange("height [mm]", 400.0, 500.0)
    until(lambda: state(desk)["holds"])
    shown = state(desk)
    assert [(s["name"], s["low"], s["high"]) for s in shown["sliders"]] == [
        ("height [mm]", 400.0, 500.0)
    ]
    assert shown["buttons"] == ["Go"]
    assert desk.GetSliderNames() == ["height [mm]"]
    assert desk.controls == ("height [mm]", "Go", "ahead")
    assert desk.GetSliderValue("height [mm]") == 477.0
    assert (desk.GetButtonClicks("Go"), desk.IsHeld("ahead")) == (0, False)
    send(desk, slider="height [mm]", value=450.0)
    send(desk, button="Go")
    until(lambda: desk.GetButtonClicks("Go") == 1 and desk.GetSliderValue("height [mm]") == 450.0)
    send(desk, hold="ahead", on=True, number=1)
    until(lambda: desk.IsHeld("ahead"))
    until(lambda: not desk.IsHeld("ahead"))  # without another word
    desk.DeleteSlider("height [mm]")
    until(lambda: not state(desk)["sliders"])
    for get in (desk.GetSliderValue, desk.DeleteSlider):
        with pytest.raises(KeyError):
            get("height [mm]")


def test_what_the_operator_did_while_nobody_asked_is_over(desk):
    desk.AddHold("ahead")
    until(lambda: state(desk)["holds"])
    send(desk, hold="ahead", on=True, number=1)
    time.sleep(2.5)  # in which more is said than a pipe holds
    state(desk)
    until(lambda: desk.silence() < 0.3)
    assert not desk.IsHeld("ahead")


def test_nothing_is_held_any_more_as_soon_as_the_process_has_ended(desk):
    # As the newest word of a process that was killed just now.
    desk.AddHold("ahead")
    heard, held = desk._heard, desk._held
    try:
        desk._heard, desk._held = (time.monotonic() + 60.0, 0.0), {"ahead"}
        assert desk.IsHeld("ahead")
        desk.wrong = "its process has ended"
        assert not desk.IsHeld("ahead")
    finally:
        desk.wrong, desk._heard, desk._held = "", heard, held


def test_it_shows_the_newest_numbers_and_draws_the_machine(desk):
    rows = (Row("roll", 1.0, 1.5, float("nan"), "deg", 1),)
    desk.show(Readout("moving", rows, ("a remark",), True, ("Go",)), SIGNALS)
    until(lambda: state(desk)["state"] == "moving")
    shown = state(desk)
    assert shown["rows"][0]["measured"] == 1.5
    assert shown["rows"][0]["true"] is None
    assert shown["remarks"] == ["a remark"]
    assert shown["idle"] == ["Go"]


def test_a_page_that_falls_silent_is_silence(desk, judge):
    with judge() as judged:
        state(desk)
        until(lambda: desk.silence() > 0.35)
    judged.check(0.55)


def test_it_never_waits_for_its_process_and_a_process_that_stands_still_is_silence(judge):
    with Desk("deploy", DeployScenario(), "a title") as desk:
        desk.AddHold("ahead")
        until(lambda: state(desk)["holds"])
        send(desk, hold="ahead", on=True, number=1)
        until(lambda: desk.IsHeld("ahead"))
        with standing_still(desk.process):
            with judge() as judged:
                for k in range(3000):
                    desk.show(Readout(f"{k}", remarks=("x" * 200,)), SIGNALS)
                    desk.GetSliderNames()
                assert len(desk._out) < 1 << 18
                until(lambda: desk.silence() > 0.3)
            assert not desk.IsHeld("ahead")
        until(lambda: state(desk)["state"].isdecimal())
        os.kill(desk.process, signal.SIGKILL)
        until(lambda: desk.silence() > 0.4)
        desk.show(Readout("nobody sees this"))
        desk.AddButton("Go")
        assert desk.GetButtonClicks("Go") == 0
    judged.check(2.0)


def test_a_page_that_cannot_begin_says_why():
    with pytest.raises(OutputError, match="the operator's page: there is no experiment 'nothing'"):
        Desk("nothing", DeployScenario(), "a title").__enter__()


# The drawing


def test_the_twin_stands_on_wheels_or_feet_as_it_measures():
    meshcat = Meshcat()
    twin = PlatformTwin(meshcat, DeployScenario().levelling)
    on_wheels = SIGNALS | {
        "legs.extension": np.full(4, 0.45),
        "attitude_estimated": np.array([0.02, 0.03]),
    }
    twin.show(on_wheels)
    assert pose(twin, "measured")[2] == pytest.approx(0.39, abs=2e-3)
    twin.show(SIGNALS | {"extension_desired_state": np.full(8, 0.41)})
    assert pose(twin, "measured")[2] == pytest.approx(0.477, abs=0.01)
    posed = SIGNALS | {
        "ground_valid": np.ones(1),
        "posture_desired_state": np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]),
    }
    twin.show(posed)
    assert pose(twin, "desired")[2] == pytest.approx(0.5)
    before = pose(twin, "measured")
    twin.show(posed | {"legs.extension": np.full(4, np.nan)})
    np.testing.assert_array_equal(pose(twin, "measured"), before)
    assert all(map(meshcat.HasPath, ("measured/arm", "desired/arm", "/measured_ground")))


def pose(twin, path):
    """Place of a drawn platform [m]."""
    port = twin._diagram.GetInputPort(f"{path}.base_pose")
    return port.Eval(twin._context)[4:]
