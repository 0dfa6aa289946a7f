"""A function that another process works out: its results, and the end of that process."""

import logging
import math
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from parapod.systems.core.background import Background

# Longer than anything here takes on a busy computer [s].
_LONGEST = 120.0


def awaited(look):
    """The first value of a call that is not None or False."""
    end = time.monotonic() + _LONGEST
    while not (found := look()) and found != 0.0:
        assert time.monotonic() < end, "it has not come"
        time.sleep(0.005)
    return found


def has_ended(pid):
    """Tell whether a process has ended, or is a zombie until its program looks."""
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_results_are_those_of_the_function():
    background = Background(math.hypot)
    assert background(3.0, 4.0) is None
    assert awaited(partial(background, 3.0, 4.0)) == 5.0
    assert background(3.0, 4.0) == 5.0
    assert awaited(partial(background, 5.0, 12.0)) == 13.0


def test_while_it_is_at_work_what_is_asked_for_last_is_next(tmp_path):
    background = Background(partial(_once_let, str(tmp_path)))
    background(0.0)
    awaited((tmp_path / "0.0").exists)
    assert [background(1.0), background(2.0)] == [None] * 2
    (tmp_path / "go").touch()
    assert awaited(partial(background, 3.0)) == 3.0
    assert {path.name for path in tmp_path.iterdir()} == {"0.0", "3.0", "go"}


def _once_let(folder, number):
    Path(folder, str(number)).touch()
    while not Path(folder, "go").exists():
        time.sleep(0.005)
    return number


def test_the_process_ends_with_the_object():
    background = Background(math.sqrt)
    pid = background.pid
    assert not has_ended(pid)
    del background
    assert has_ended(pid)


def test_a_process_that_dies_is_named_in_one_line_and_gives_no_results(caplog):
    background = Background(math.sqrt)
    os.kill(background.pid, signal.SIGKILL)
    with caplog.at_level(logging.WARNING):
        awaited(lambda: background(4.0) is None and caplog.messages)
        assert [background(x) for x in (4.0, 9.0, 4.0)] == [None] * 3
    (line,) = caplog.messages
    assert str(background.pid) in line
    assert "\n" not in line


PROGRAM = """
import os, sys, time
from parapod.systems.core.background import Background

background = Background(time.sleep)
background(0.1)
print(background.pid, flush=True)
sys.stdin.readline()
"""


@pytest.mark.parametrize("how", [None, signal.SIGTERM, signal.SIGKILL])
def test_the_process_ends_with_the_program_however_that_ends(how, tmp_path):
    """And a program without a guard against being imported is not run twice."""
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    program = subprocess.Popen(
        [sys.executable, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    pid = int(program.stdout.readline())
    if how is not None:
        program.send_signal(how)
    assert program.communicate()[0] == ""
    awaited(lambda: has_ended(pid))


def test_the_process_has_ordinary_priority():
    background = Background(_policy)
    assert awaited(partial(background, 0.0)) == os.SCHED_OTHER


def _policy(pid):
    return float(os.sched_getscheduler(int(pid)))
