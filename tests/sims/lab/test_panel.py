"""The page beside a Meshcat scene: its controls, its numbers, and whom it obeys."""

import json
import re
import subprocess
import sys
import time
import urllib.error
import urllib.request
from urllib.parse import urlsplit

import pytest
from pydrake.geometry import Meshcat

from parapod.sims.lab.panel import Panel, Readout, Row


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


@pytest.fixture
def panel(meshcat):
    panel = Panel(meshcat, "A machine & its <controls>")
    yield panel
    panel.close()


def admitted(panel, path="/"):
    """Address of a path with the token."""
    page, token = panel.web_url().split("/?")
    return f"{page}{path}{'&' if '?' in path else '?'}{token}"


def ask(panel, path="/", body=None, **headers):
    """Status and content of an answer."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(admitted(panel, path), data, headers)
    try:
        with urllib.request.urlopen(request, timeout=60.0) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, b""


def state(panel):
    return json.loads(ask(panel, "/state")[1])


def send(panel, body):
    """Status of what the panel's own page sends."""
    return ask(panel, "/", body, Origin=panel.web_url().partition("/?")[0])[0]


def test_the_page_frames_the_scene_under_its_title(panel, meshcat):
    status, page = ask(panel)
    assert status == 200
    assert b"A machine &amp; its &lt;controls&gt; - parapod" in page
    assert f":{meshcat.port()}/".encode() in page
    assert ask(panel, "/elsewhere")[0] == 404
    assert "localhost" in repr(panel)


def test_the_bar_of_meshcats_own_controls_is_above_what_is_seen(panel, meshcat):
    page = ask(panel)[1].decode()
    (frame,) = re.findall(r"\n  iframe \{(.*?)\}", page)
    (shift,) = re.findall(r"top: -(\d+)px", frame)
    assert f"height: calc(100% + {shift}px)" in frame
    (stage,) = re.findall(r"#stage \{(.*?)\}", page)[:1]
    assert "overflow: hidden" in stage
    assert '<div id="stage"><iframe' in page
    bars = re.findall(r"\.close-button\{[^}]*?height:(\d+)px;cursor", meshcat.StaticHtml())
    assert bars == [shift]


def test_numbers_are_shown_as_they_are_and_nothing_for_what_is_not_known(panel):
    rows = (Row("roll", 1.0, 1.5, float("nan"), "deg", 1), Row("time", measured=float("inf")))
    panel.show(Readout("moving", rows, ("a fault",), True))
    shown = state(panel)
    assert shown["state"] == "moving"
    assert shown["is_alarming"]
    assert shown["remarks"] == ["a fault"]
    assert shown["rows"][0] == {
        "label": "roll",
        "asked": 1.0,
        "measured": 1.5,
        "true": None,
        "unit": "deg",
        "decimals": 1,
    }
    assert shown["rows"][1]["measured"] is None


def test_a_slider_moved_in_the_browser_takes_whole_steps_within_its_range(panel):
    panel.AddSlider("height [mm]", 390.0, 570.0, 2.0, 477.0)
    assert panel.GetSliderNames() == ["height [mm]"]
    for sent, taken in ((480.9, 480.0), (1e9, 570.0), (-5, 390.0)):
        assert send(panel, {"slider": "height [mm]", "value": sent}) == 204
        assert panel.GetSliderValue("height [mm]") == pytest.approx(taken)
    assert panel.SetSliderValue("height [mm]", 401.2) == pytest.approx(402.0)
    (slider,) = state(panel)["sliders"]
    assert slider["sets"] == 1  # what the browser sent it need not be told


def test_a_range_takes_a_value_beyond_it_to_its_end(panel):
    panel.AddSlider("roll [deg]", -7.0, 7.0, 0.1, 5.0)
    panel.SetSliderRange("roll [deg]", -1.0, 6.0)
    assert panel.GetSliderValue("roll [deg]") == pytest.approx(5.0)
    panel.SetSliderRange("roll [deg]", -1.0, 2.5)
    assert panel.GetSliderValue("roll [deg]") == pytest.approx(2.5)
    (slider,) = state(panel)["sliders"]
    assert (slider["low"], slider["high"], slider["sets"]) == (-1.0, 2.5, 1)
    with pytest.raises(ValueError, match=r"from 2\.0 to 1\.0 has no values"):
        panel.SetSliderRange("roll [deg]", 2.0, 1.0)


def test_clicks_are_counted_since_the_button_was_shown(panel):
    panel.AddButton("Stop")
    assert panel.GetButtonClicks("Stop") == 0
    for _ in range(2):
        assert send(panel, {"button": "Stop"}) == 204
    assert panel.GetButtonClicks("Stop") == 2
    panel.DeleteButton("Stop")
    assert panel.GetButtonNames() == state(panel)["buttons"] == []
    panel.AddButton("Stop")
    assert panel.GetButtonClicks("Stop") == 0


@pytest.mark.parametrize(
    "body",
    [
        {"slider": "no such", "value": 1.0},
        {"slider": "roll", "value": "1"},
        {"slider": "roll", "value": float("nan")},
        {"slider": "roll"},
        {"button": "no such"},
        {"button": 1},
        [],
        "roll",
        None,
        {"slider": "roll", "value": 1.0, "padding": 5000 * "x"},
    ],
    ids=str,
)
def test_what_the_page_cannot_have_sent_is_refused_and_changes_nothing(panel, body):
    panel.AddSlider("roll", -2.0, 2.0, 0.1, 0.5)
    panel.AddButton("Stop")
    before = state(panel)
    assert send(panel, body if body is not None else {}) == 400
    assert state(panel) == before


@pytest.mark.parametrize(
    "headers",
    [{}, {"Origin": "http://elsewhere.example"}, {"Origin": "null"}],
    ids=["none", "another", "sandboxed"],
)
def test_pages_of_others_move_nothing(panel, headers):
    panel.AddButton("Go")
    assert ask(panel, "/", {"button": "Go"}, **headers)[0] == 403
    assert panel.GetButtonClicks("Go") == 0


def test_a_stranger_s_name_for_this_computer_is_refused(panel):
    port = urlsplit(panel.web_url()).port
    for path, body in (("/", None), ("/state", None), ("/", {"button": "Go"})):
        host = f"rebound.example:{port}"
        assert ask(panel, path, body, Host=host, Origin=f"http://{host}")[0] == 403


def test_a_closed_page_is_gone_and_its_port_serves_the_next_run(meshcat):
    first = Panel(meshcat, "one")
    address, run = first.web_url(), state(first)["run"]
    second = Panel(meshcat, "two")
    assert second.web_url() != address
    second.close()
    first.close()
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(address, timeout=2.0)
    again = Panel(meshcat, "three")
    assert again.web_url() == address
    assert state(again)["run"] != run  # so that an open page loads anew
    again.close()


@pytest.mark.parametrize("delete", ["DeleteSlider", "DeleteButton"])
def test_deleting_what_is_not_there_is_an_error_unless_it_may_be(panel, delete):
    with pytest.raises(KeyError, match="no such"):
        getattr(panel, delete)("no such")
    assert getattr(panel, delete)("no such", strict=False) is False


def test_a_slider_needs_a_range_and_a_name_of_its_own(panel):
    panel.AddSlider("roll", -2.0, 2.0, 0.1, 0.5)
    with pytest.raises(ValueError, match="there is a slider named 'roll'"):
        panel.AddSlider("roll", -2.0, 2.0, 0.1, 0.5)
    with pytest.raises(ValueError, match="has no values"):
        panel.AddSlider("pitch", 2.0, -2.0, 0.1, 0.5)


# Buttons that are held


def test_a_button_is_held_while_its_page_says_so(panel):
    panel.AddHold("ahead", "ArrowUp")
    assert panel.GetHoldNames() == ["ahead"]
    assert state(panel)["holds"] == [{"name": "ahead", "key": "ArrowUp"}]
    assert not panel.IsHeld("ahead")
    assert send(panel, {"hold": "ahead", "on": True, "number": 5}) == 204
    assert panel.IsHeld("ahead")
    assert send(panel, {"hold": "ahead", "on": False, "number": 7}) == 204
    assert not panel.IsHeld("ahead")
    # One that was overtaken on its way.
    assert send(panel, {"hold": "ahead", "on": True, "number": 6}) == 204
    assert not panel.IsHeld("ahead")
    panel.DeleteHold("ahead")
    assert state(panel)["holds"] == []
    assert send(panel, {"hold": "ahead", "on": True, "number": 8}) == 400


def test_a_button_is_let_go_when_nothing_more_is_heard(panel, judge):
    panel.AddHold("ahead")
    with judge() as judged:
        send(panel, {"hold": "ahead", "on": True, "number": 1})
        while panel.IsHeld("ahead"):
            time.sleep(0.01)
    assert judged.took > 0.1
    judged.check(0.45)


# Who operates


def test_one_page_operates_until_another_takes_over(panel):
    panel.AddButton("Go")

    def looks(page):
        return not json.loads(ask(panel, f"/state?page={page}")[1])["operates"]

    assert not looks("first")
    assert looks("second")
    assert send(panel, {"page": "second", "button": "Go"}) == 400
    assert panel.GetButtonClicks("Go") == 0
    assert send(panel, {"page": "second", "take_over": True}) == 204
    assert looks("first")
    assert send(panel, {"page": "second", "button": "Go"}) == 204
    assert panel.GetButtonClicks("Go") == 1


def test_silence_is_that_of_the_page_that_operates(panel, judge):
    assert panel.silence() == float("inf")
    begun = time.monotonic()
    assert ask(panel, "/beat?page=first")[0] == 204
    assert panel.silence() <= time.monotonic() - begun
    with judge() as judged:
        while time.monotonic() < begun + 0.3:
            ask(panel, "/beat?page=second")  # one that only looks
            time.sleep(0.02)
        silence = panel.silence()
    assert silence <= time.monotonic() - begun
    judged.check_at_least(silence, 0.25)
    time.sleep(0.8)
    begun = time.monotonic()
    ask(panel, "/beat?page=second")  # the first one has been closed
    assert panel.silence() <= time.monotonic() - begun
    assert json.loads(ask(panel, "/state?page=second")[1])["operates"]


# Who has the token


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1"])
def test_without_the_token_nothing_is_shown_or_obeyed(meshcat, host):
    panel = Panel(meshcat, "one", host=host)
    try:
        panel.AddButton("Go")
        panel.AddSlider("roll", -2.0, 2.0, 0.1, 0.5)
        panel.AddHold("ahead")
        url, token = panel.web_url().split("/?token=")
        assert len(token) > 16

        def asked(path, body=None, **headers):
            data = None if body is None else json.dumps(body).encode()
            request = urllib.request.Request(url + path, data, headers)
            try:
                with urllib.request.urlopen(request, timeout=60.0) as answer:
                    assert answer.headers["Set-Cookie"] is None
                    return answer.status
            except urllib.error.HTTPError as error:
                return error.code

        commands = (
            {"button": "Go"},
            {"slider": "roll", "value": 1.0},
            {"hold": "ahead", "on": True, "number": 1},
            {"take_over": True},
        )
        for query in ("", "?token=", "?token=wrong", f"?token={token[:-1]}", f"?token={token}x"):
            for path in ("/", "/state", "/beat", "/samples", "/plotly.js", "/elsewhere"):
                assert asked(path + query) == 403
            for body in commands:
                assert asked(f"/{query}", body, Origin=url) == 403
                cookie = f"parapod={token}; token={token}"
                assert asked(f"/{query}", body, Origin=url, Cookie=cookie) == 403
        assert panel.silence() == float("inf")
        assert (panel.GetButtonClicks("Go"), panel.IsHeld("ahead")) == (0, False)
        assert panel.GetSliderValue("roll") == pytest.approx(0.5)
        assert asked(f"/state?page=a&token={token}") == 200
        for body in commands:
            asked(f"/?token={token}", {"page": "a"} | body, Origin="http://elsewhere")
        assert panel.GetButtonClicks("Go") == 0
        for body in commands:
            assert asked(f"/?token={token}", {"page": "a"} | body, Origin=url) == 204
        assert panel.GetButtonClicks("Go") == 1
    finally:
        panel.close()


def test_another_program_has_another_token(meshcat, panel):
    run = "from parapod.sims.lab import panel; print(panel._TOKEN)"
    other = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, check=True)
    assert other.stdout.strip() not in panel.web_url()
    assert len(other.stdout.strip()) > 16
