"""The measurement of how punctually a computer runs the controller."""

import io
import json
import re
import time

import numpy as np
import pytest
from rich.console import Console

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.cli.bench_rt import (
    Punctuality,
    bench_real_time,
    print_punctuality,
    wake_up_latency,
)
from parapod.sims.cli.main import main
from parapod.sims.real_machine.real_time import RealTimeLoop

KEYS = {
    "rate_hz",
    "missed",
    *(
        f"{what}_{which}_ms"
        for what in ("period_error", "cost", "wake_up")
        for which in ("p50", "p99", "max")
    ),
}


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """The one line that a mistaken command line is answered with."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        assert main(["bench-rt", *arguments]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1
        assert list(tmp_path.iterdir()) == []
        return err.removeprefix("parapod: error: ").rstrip()

    return run


def punctuality(scale, rate=1000.0, missed=10_000):
    values = np.array([0.1234, 1.234, 9.876]) * scale
    return Punctuality(rate, values, 2.0 * values, missed, 3.0 * values)


def printed(*results):
    stream = io.StringIO()
    print_punctuality(results, Console(file=stream, width=80))
    return stream.getvalue()


# Figures


def test_figures_are_named_and_in_milliseconds():
    figures = punctuality(1e-3, rate=100.0, missed=3).as_json()
    assert figures.keys() == KEYS
    assert (figures["rate_hz"], figures["missed"]) == (100.0, 3)
    assert figures["period_error_p50_ms"] == pytest.approx(0.1234)
    assert figures["cost_p99_ms"] == pytest.approx(2.468)
    assert figures["wake_up_max_ms"] == pytest.approx(29.628)
    assert json.loads(json.dumps(figures)) == figures


@pytest.mark.parametrize("scale", [1e-5, 1e-4, 1e-3, 1e-2, 3e-2, 0.1, 0.3])
def test_the_table_fits_80_columns_and_cuts_nothing_off(scale):
    text = printed(punctuality(scale), punctuality(1e-4, 20.0, 0))
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    row = next(line for line in text.splitlines() if "1000 Hz" in line)
    shown = [float(number) for number in re.findall(r"[0-9.]+", row)]
    assert shown[0] == 1000.0
    times = 1e3 * scale * np.array([0.1234, 1.234, 9.876])
    expected = [*times, *(2.0 * times), 10_000, *(3.0 * times)]
    np.testing.assert_allclose(shown[1:], expected, rtol=0.01, atol=0.005)


def test_the_table_says_what_its_numbers_are():
    text = printed(punctuality(1e-4))
    for word in ("rate", "period error", "tick cost", "missed", "wake-up alone"):
        assert word in text
    assert "median / 99 % / largest, in milliseconds" in text


# Measurement


def test_waking_up_is_never_early_and_happens_once_a_period():
    began = time.monotonic()
    late = wake_up_latency(0.005, 0.1)
    assert time.monotonic() - began >= 0.1
    assert len(late) == 20
    assert min(late) >= 0.0


def test_each_rate_is_run_for_its_time():
    console = Console(file=io.StringIO())
    scenario = LevellingScenario(backend="mock")
    (result,) = bench_real_time(scenario, [50.0], 1.0, console)
    assert result.rate == 50.0
    for three in (result.period_error, result.cost, result.wake_up):
        assert three.shape == (3,)
        assert (np.diff(three) >= 0.0).all()
    assert (result.cost > 0.0).all()
    assert result.missed < 50
    assert scenario.control.period == LevellingScenario().control.period


def test_the_figures_are_of_all_ticks_however_many(monkeypatch):
    made = []

    class Remembered(RealTimeLoop):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            made.append(self)

    monkeypatch.setattr("parapod.sims.bench_rt.RealTimeLoop", Remembered)
    console = Console(file=io.StringIO())
    bench_real_time(LevellingScenario(backend="mock"), [50.0], 1.0, console)
    assert made[0].timing.late.maxlen is None


def test_the_command_prints_a_table_and_writes_the_figures(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    arguments = ["bench-rt", "--rates", "100", "--seconds", "1", "--json", "figures.json"]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "100 Hz" in out
    assert out.endswith("wrote figures.json\n")
    assert max(map(len, out.splitlines())) <= 80
    written = json.loads((tmp_path / "figures.json").read_text())
    assert [rates.keys() for rates in written["rates"]] == [KEYS]
    assert written["rates"][0]["rate_hz"] == 100.0


# Refusals


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("--rates 19", "--rates 19 is outside 20..1000 Hz"),
        ("--rates 100 1001", "--rates 1001 is outside 20..1000 Hz"),
        ("--rates -5", "--rates -5 is outside 20..1000 Hz"),
        ("--rates nan", "--rates nan is outside 20..1000 Hz"),
        ("--seconds 0.9", "--seconds 0.9 is outside 1..3600"),
        ("--seconds 3601", "--seconds 3601 is outside 1..3600"),
        ("--seconds inf", "--seconds inf is outside 1..3600"),
        ("--seconds nan", "--seconds nan is outside 1..3600"),
        ("--json no/x.json", "cannot write 'no/x.json': the folder 'no' does not exist"),
    ],
)
def test_what_cannot_be_measured_is_refused_before_it_is_tried(refused, arguments, said):
    assert refused(*arguments.split()) == said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("--rates", "argument --rates: expected at least one argument"),
        ("--rates fast", "argument --rates: invalid float value: 'fast'"),
        ("--backend multibody", "argument --backend: invalid choice: 'multibody'"),
    ],
)
def test_a_wrong_command_line_is_one_line(refused, arguments, said):
    assert refused(*arguments.split()).startswith(said)


def test_the_machine_itself_is_not_measured(refused):
    assert refused("--backend", "hardware").startswith("argument --backend: invalid choice")
