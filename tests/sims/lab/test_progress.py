"""Progress of long work: a bar on a terminal, a line from time to time in a file."""

import io
from types import SimpleNamespace

import pytest
from rich.console import Console

from parapod.sims.lab.progress import counted, progress


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
    monkeypatch.setattr("parapod.sims.lab.progress.time", clock)
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
