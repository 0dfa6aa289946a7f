"""Progress of long work: a bar on a terminal, a line from time to time in a file."""

import io
import threading
import time
from dataclasses import dataclass
from types import SimpleNamespace

import pytest
from rich.console import Console

from parapod.sims.lab.experiment import Experiment
from parapod.sims.output.options import RunOptions
from parapod.sims.output.progress import counted, progress, waiting
from parapod.systems.core.schema import Schema, choice, quantity


def test_progress_is_silent_in_a_file_until_a_line_is_due():
    stream = io.StringIO()
    with progress(Console(file=stream), "levelling", 60.0) as update:
        for simulated in range(60):
            update(float(simulated))
    assert stream.getvalue() == ""


@pytest.fixture
def clock(monkeypatch):
    """The time that progress is told, which only goes on by being set; lines are wanted."""
    monkeypatch.delenv("PARAPOD_PROGRESS")
    clock = SimpleNamespace(now=0.0, monotonic=lambda: clock.now)
    monkeypatch.setattr("parapod.sims.output.progress.time", clock)
    return clock


def test_progress_prints_lines_to_a_file(clock):
    stream = io.StringIO()
    with progress(Console(file=stream), "levelling [x]", 60.0, line_period=5.0) as update:
        update(11.0)
        clock.now = 6.0
        update(12.0)
        update(13.0)
    assert stream.getvalue() == "levelling [x]: 12.0 of 60.0 s, 2 x real time\n"


@pytest.mark.parametrize("shown", [progress, counted])
def test_lines_can_be_left_out_and_bars_cannot(shown, clock, monkeypatch):
    monkeypatch.setenv("PARAPOD_PROGRESS", "off")
    stream, terminal = io.StringIO(), io.StringIO()
    for console in (Console(file=stream), Console(file=terminal, force_terminal=True, width=80)):
        with shown(console, "levelling", 60) as update:
            clock.now += 100.0
            update(12)
    assert stream.getvalue() == ""
    assert "levelling" in terminal.getvalue()


def test_progress_is_a_bar_on_a_terminal_that_ends_where_the_run_did():
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=80)
    with progress(console, "levelling", 60.0) as update:
        for simulated in range(50):
            update(float(simulated))
    assert "49.0 of 60.0 s, " in stream.getvalue().rsplit("\r", 1)[-1]


def test_progress_restores_the_terminal_after_an_exception():
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=80)
    with pytest.raises(ZeroDivisionError), progress(console, "levelling", 60.0):
        raise ZeroDivisionError
    hide, show = "\x1b[?25l", "\x1b[?25h"
    assert stream.getvalue().rfind(show) > stream.getvalue().rfind(hide)


def test_counted_work_says_how_much_is_done_and_how_long_the_rest_takes(clock):
    stream = io.StringIO()
    with counted(Console(file=stream), "faults [x]", 40, line_period=5.0) as report:
        report(9)
        clock.now = 6.0
        report(10)
        report(11)
    assert stream.getvalue() == "faults [x]: 10 of 40, 1.67/s, 18 s left\n"
    terminal = io.StringIO()
    with counted(Console(file=terminal, force_terminal=True, width=80), "faults", 40) as report:
        report(40)
    assert "40 of 40" in terminal.getvalue()


@dataclass
class PlannerScenario(Schema):
    """Nothing to plan with.

    Attributes:
        backend: the only one.
        seed: has no effect.
    """

    backend: str = choice("kinematic", ("kinematic",))
    seed: int = quantity(0, 0, 2**31 - 1)


class Watched(io.StringIO):
    """A stream that says when something has been written that holds a word."""

    def __init__(self, word):
        super().__init__()
        self.word, self.told = word, threading.Event()

    def write(self, text):
        written = super().write(text)
        if self.word in self.getvalue():
            self.told.set()
        return written


def test_work_of_unknown_length_is_shown_by_a_spinner_that_is_gone_afterwards(monkeypatch):
    monkeypatch.delenv("PARAPOD_PROGRESS")
    stream = Watched("planning [x]")
    console = Console(file=stream, force_terminal=True, width=80)
    with waiting(console, "planning [x]", patience=0.0):
        assert stream.told.wait(60.0)
    assert stream.getvalue().endswith("\x1b[2K")  # erases its line


def test_work_of_unknown_length_is_not_shown_to_who_compares_what_is_printed():
    stream = io.StringIO()
    with waiting(Console(file=stream, force_terminal=True), "planning", patience=0.0):
        time.sleep(0.01)
    assert stream.getvalue() == ""


def test_work_that_is_over_soon_or_fails_is_not_shown(monkeypatch):
    monkeypatch.delenv("PARAPOD_PROGRESS")
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=80)
    with pytest.raises(ZeroDivisionError), waiting(console, "planning", patience=60.0):
        raise ZeroDivisionError
    assert stream.getvalue() == ""


def test_work_of_unknown_length_is_told_in_lines_where_these_are_wanted(monkeypatch):
    monkeypatch.delenv("PARAPOD_PROGRESS")
    stream = Watched("\n")
    with waiting(Console(file=stream), "planning [x]", line_period=0.001):
        assert stream.told.wait(60.0)
    assert stream.getvalue().startswith("planning [x]: 0 s\n")
    silent = io.StringIO()
    with waiting(Console(file=silent), "planning"):
        pass
    assert silent.getvalue() == ""


class Planner(Experiment):
    """Plans until it is seen to plan."""

    schema = PlannerScenario
    backends = ("kinematic",)

    def __init__(self, told):
        super().__init__("planner")
        self.told = told

    def check(self, scenario):
        assert self.told.wait(60.0)

    def run(self, scenario, runner):
        return None


def test_an_experiment_that_plans_for_long_shows_it_before_it_runs(monkeypatch):
    monkeypatch.delenv("PARAPOD_PROGRESS")
    stream = Watched("planner: planning")
    console = Console(file=stream, force_terminal=True, width=80)
    Planner(stream.told).execute(PlannerScenario(), RunOptions(console=console))
