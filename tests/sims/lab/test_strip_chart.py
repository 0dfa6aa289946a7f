"""The newest samples of a loop beside its scene: which they are, and that they are the loop's."""

import json
import math
import sys
from urllib.parse import urlsplit

import numpy as np
import pytest
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machine import find_machine, list_machines
from parapod.diagrams.plots import parse
from parapod.sims.lab.panel import Panel, Readout
from parapod.sims.lab.runner import Live, shown_on
from parapod.sims.lab.strip_chart import LENGTH, PERIOD, StripChart
from tests.sims.lab.test_panel import ask, state

pytest.importorskip("plotly")
PLATFORM = find_machine("levelling_platform")
DEG, MM = math.degrees(1.0), 1e3


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


@pytest.fixture
def panel(meshcat):
    panel = Panel(meshcat, "a machine")
    yield panel
    panel.close()


@pytest.fixture
def chart():
    return StripChart(PLATFORM, {"legs.extension": 4, "legs.voltage": 4, "a.thing": 2})


def read_nothing(loop, root_context):
    return Readout()


def sample(value):
    return {"legs.extension": np.full(4, value), "legs.voltage": np.arange(4.0)}


def samples(panel, since):
    return json.loads(ask(panel, f"/samples?since={since}")[1])


def test_the_usual_plots_are_drawn_as_far_as_there_are_signals(chart):
    assert chart.signals == ("legs.extension", "legs.voltage")
    labels = [trace["legendgroup"] for trace in chart.description["traces"]]
    assert labels == [
        f"{k} legs.{n}[{i}]" for k, n in enumerate(("extension", "voltage")) for i in range(4)
    ]
    assert chart.description["places"] == [0] * 4 + [1] * 4
    ends_mm = [MM * end for end in PLATFORM.table["legs.extension"].limits]
    assert chart.description["limits"][0] == pytest.approx(ends_mm)
    json.dumps(chart.description, allow_nan=False)


def test_the_platform_shows_its_posture_desired_and_measured_its_legs_and_their_voltages():
    sizes = {name: port.size for name, port in PLATFORM.table.items() if port.size}
    drawn = StripChart(
        PLATFORM, sizes | {"posture_desired_state": 3, "attitude_estimated": 2}
    ).signals
    assert {"posture_desired_state", "attitude_estimated", "legs.extension", "legs.voltage"} <= {
        *drawn
    }


def test_numbers_are_in_the_units_that_people_read_and_those_that_are_none_are_left_open(chart):
    chart.add(0.25, sample(0.4123456789))
    chart.add(0.30, sample(math.nan))
    rows = chart.since(0)["rows"]
    assert rows[0] == [0.25, *[412.346] * 4, 0.0, 1.0, 2.0, 3.0]
    assert rows[1][1:5] == [None] * 4


def test_a_page_is_given_what_it_does_not_know_yet_and_no_more_than_the_newest(chart):
    times = np.arange(0.0, 3.0 * LENGTH, 0.01)
    for t in times:
        if chart.wants(t):
            chart.add(t, sample(t))
    got = chart.since(0)
    apart = np.diff([row[0] for row in got["rows"]])
    np.testing.assert_allclose(apart, PERIOD, atol=1e-6)
    assert got["rows"][-1][0] - got["rows"][0][0] == pytest.approx(LENGTH)
    assert got["number"] == pytest.approx(3.0 * LENGTH / PERIOD, abs=1)
    assert len(chart.since(got["number"] - 3)["rows"]) == 3
    for known in (got["number"], got["number"] + 7):
        assert chart.since(known) == {"number": got["number"], "rows": []}


def test_a_run_that_begins_anew_forgets_the_one_before(chart):
    for t in (5.0, 5.1, 0.0, 0.1):
        assert chart.wants(t)
        chart.add(t, sample(t))
    assert [row[0] for row in chart.since(0)["rows"]] == [0.0, 0.1]
    assert chart.since(3)["rows"] == chart.since(0)["rows"][1:]


@pytest.mark.parametrize("machine", list_machines(), ids=lambda machine: machine.name)
def test_what_is_plotted_is_what_is_recorded(machine, panel):
    scenario = machine.scenario(backend=[*machine.plants][-1])
    loop = ClosedLoop(machine, scenario)
    simulator = Simulator(loop)
    loop.reset(simulator.get_mutable_context())
    simulator.set_monitor(shown_on(panel, read_nothing, loop, simulator.get_context()))
    simulator.AdvanceTo(0.2)
    recorded = loop.recording(simulator.get_context())
    described, got = json.loads(ask(panel, "/samples")[1]), samples(panel, 0)
    assert len(got["rows"]) == pytest.approx(0.2 / PERIOD, abs=1)
    factors = {"mm": MM, "mm/s": MM, "deg": DEG, "deg/s": DEG}
    compared = 0
    for t, *values in got["rows"]:
        (at,) = np.flatnonzero(np.isclose(recorded.time, t, atol=1e-9)).tolist() or [None]
        if at is None:
            continue
        for trace, value in zip(described["traces"], values, strict=True):
            name, element = parse(trace["legendgroup"].partition(" ")[2])
            unit = trace["hovertemplate"].partition("} ")[2].partition("<")[0]
            true = recorded[name][at, (element or [0])[0]] * factors.get(unit, 1.0)
            shown = math.nan if value is None else value
            assert shown == pytest.approx(true, rel=1e-5, abs=1e-9, nan_ok=True), trace
            compared += 1
    assert compared >= len(described["traces"]) * 2


def test_the_page_is_given_the_chart_and_what_draws_it(panel, chart):
    assert state(panel)["chart"] == 0
    assert samples(panel, 0) == {}
    assert ask(panel, "/plotly.js")[0] == 404
    panel.plot(chart)
    first = state(panel)["chart"]
    assert first > 0
    status, script = ask(panel, "/plotly.js")
    assert status == 200
    assert b"Plotly" in script
    chart.add(0.0, sample(0.4))
    assert samples(panel, 0)["number"] == 1
    assert samples(panel, 1)["rows"] == []
    panel.plot(chart)
    assert state(panel)["chart"] > first  # another one: it is asked for anew
    panel.plot(None)
    assert state(panel)["chart"] == 0


def test_a_stranger_s_name_for_this_computer_is_told_no_sample(panel, chart):
    panel.plot(chart)
    port = urlsplit(panel.web_url()).port
    for path in ("/samples", "/plotly.js"):
        assert ask(panel, path, Host=f"rebound.example:{port}")[0] == 403


def test_without_plotly_there_are_numbers_and_one_remark(panel, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly", None)
    loop = ClosedLoop(PLATFORM, PLATFORM.scenario(backend="kinematic"))
    simulator, said = Simulator(loop), []
    monitor = shown_on(panel, read_nothing, loop, simulator.get_context(), said.append)
    monitor(simulator.get_context())
    assert len(said) == 1
    assert said[0].startswith("no plots beside the scene: ")
    assert "parapod[replay]" in said[0]
    assert state(panel)["chart"] == 0


def test_a_loop_that_goes_on_after_a_run_is_plotted_too(panel):
    live = Live(
        panel, ClosedLoop(PLATFORM, PLATFORM.scenario(backend="kinematic"), log=()), read_nothing
    )
    live.begin()
    live.advance(0.21)
    assert [row[0] for row in samples(panel, 0)["rows"]] == pytest.approx(
        [0.0, 0.05, 0.1, 0.15, 0.2]
    )
    live.begin()
    live.advance(0.11)
    assert [row[0] for row in samples(panel, 0)["rows"]] == pytest.approx([0.0, 0.05, 0.1])
