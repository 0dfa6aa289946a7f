"""Progress of long work: a bar on a terminal, a line from time to time in a file."""

import io
import re
import time

import pytest
from rich.console import Console

from parapod.sims.lab.progress import counted, progress


def test_progress_is_silent_in_a_file_until_a_line_is_due():
    stream = io.StringIO()
    with progress(Console(file=stream), "levelling", 60.0) as update:
        for simulated in range(60):
            update(float(simulated))
    assert stream.getvalue() == ""


def test_progress_prints_lines_to_a_file():
    stream = io.StringIO()
    with progress(Console(file=stream), "levelling [x]", 60.0, line_period=0.01) as update:
        time.sleep(0.02)
        update(12.0)
        update(13.0)
    line, end = stream.getvalue().split("\n")
    assert line.startswith("levelling [x]: 12.0 of 60.0 s, ")
    assert line.endswith(" x real time")
    assert end == ""


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


def test_counted_work_says_how_much_is_done_and_how_long_the_rest_takes():
    stream = io.StringIO()
    with counted(Console(file=stream), "faults [x]", 40, line_period=0.01) as report:
        time.sleep(0.02)
        report(10)
        report(11)
    assert re.fullmatch(r"faults \[x\]: 10 of 40, \d+ s left\n", stream.getvalue())
    terminal = io.StringIO()
    with counted(Console(file=terminal, force_terminal=True, width=80), "faults", 40) as report:
        report(40)
    assert "40 of 40" in terminal.getvalue()
