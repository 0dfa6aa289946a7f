"""The measurement of how punctually a computer runs the controller."""

import io
import json
import re
import time

import numpy as np
import pytest
from rich.console import Console

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.cli.main import main
from parapod.sims.real_machine.punctuality import (
    Punctuality,
    measure_punctuality,
    print_punctuality,
)
from parapod.sims.real_machine.real_time import RealTimeLoop
from parapod.sims.real_machine.wake_up import wake_up_latency

KEYS = {
    "rate_hz",
    "missed",
    *(
        f"{what}_{which}_ms"
        for what in ("period_error", "cost", "wake_up")
        for which in ("p50", "p99", "max")
    ),
}


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


def test_a_rate_is_run_for_its_time_and_judged_by_all_its_ticks(monkeypatch):
    made = []

    class Remembered(RealTimeLoop):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            made.append(self)

    monkeypatch.setattr("parapod.sims.real_machine.punctuality.RealTimeLoop", Remembered)
    scenario = LevellingScenario(backend="mock")
    console = Console(file=io.StringIO())
    (result,) = measure_punctuality(PLATFORM, scenario, [50.0], 1.0, console)
    assert result.rate == 50.0
    for three in (result.period_error, result.cost, result.wake_up):
        assert three.shape == (3,)
        assert (np.diff(three) >= 0.0).all()
    assert (result.cost > 0.0).all()
    timing = made[0].timing
    assert (timing.ticks, timing.missed) == (50, result.missed)
    assert timing.late.maxlen is None
    assert scenario.control.period == LevellingScenario().control.period


@pytest.mark.parametrize(
    "experiment", ["level", pytest.param("chair-walk", marks=pytest.mark.slow)]
)
def test_the_command_prints_a_table_and_writes_the_figures(experiment, work, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    command = f"bench-rt --of {experiment} --rates 50 --seconds 1 --json figures.json"
    assert main(command.split()) == 0
    out = capsys.readouterr().out
    assert "50 Hz" in out
    assert out.endswith("wrote figures.json\n")
    assert max(map(len, out.splitlines())) <= 80
    written = json.loads((work / "figures.json").read_text())
    assert [rates.keys() for rates in written["rates"]] == [KEYS]
    assert written["rates"][0]["rate_hz"] == 50.0
