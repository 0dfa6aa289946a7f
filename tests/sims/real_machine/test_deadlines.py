"""Settings that are measured in turns."""

import errno
import io
import json
import os
import signal
import subprocess
import sys
import time

import pytest
from rich.console import Console

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.cli.main import main
from parapod.sims.real_machine.deadlines import (
    Measured,
    Setting,
    compare_settings,
    print_settings,
    settings_lines,
    settings_of,
)
from parapod.sims.real_machine.privileges import CORE, FIFO, MEMORY, PRIVILEGES, Kernel, Outcome
from parapod.sims.real_machine.real_time import USUAL, Timing
from parapod.systems.core.errors import OutputError

QUIET = Console(file=io.StringIO())


def measured(setting, scale=1e-3, rate=100.0, ended=(), **outcomes):
    one = Measured(setting, rate, ended=list(ended))
    one.late = one.period_error = one.cost = one.wake_up = [scale, 2.0 * scale]
    one.ages, one.ticks, one.missed = [3.0 * scale], 500, round(1e3 * scale)
    one.outcomes = {name: Outcome(name, *given) for name, given in outcomes.items()}
    return one


def test_settings_are_those_of_a_job_or_each_privilege_beside_none():
    assert [one.asked for one in settings_of(False, False)] == [USUAL]
    asked = [one.asked for one in settings_of(True, False)]
    assert asked == [(), (FIFO,), (MEMORY,), (CORE,), PRIVILEGES]
    names = [one.name for one in settings_of(False, True)]
    assert names == ["as a job", "as a job, log"]
    assert [one.is_logged for one in settings_of(True, True)] == [False, True] * 5


@pytest.mark.parametrize("scale", [1e-5, 1e-3, 1e-2, 0.1, 0.3])
def test_the_table_fits_80_columns_and_cuts_nothing_off(scale):
    stream = io.StringIO()
    rows = [measured(setting, scale) for setting in settings_of(True, True)]
    print_settings(rows, Console(file=stream, width=80))
    text = stream.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    assert all(row.setting.name in text for row in rows)


def test_each_privilege_is_told_with_its_refusal_or_with_what_it_changed():
    ordinary, fifo, memory, *_ = settings_of(True, False)
    refused = (False, "EPERM; the limit memlock is 8192 kB, unlimited is needed")
    rows = [
        measured(ordinary, 4e-3),
        measured(fifo, 1e-3, ended=["the computer is too slow"], SCHED_FIFO=(True, "priority 40")),
        measured(memory, 2e-3, mlockall=refused),
    ]
    assert settings_lines(rows) == [
        "SCHED_FIFO taken: priority 40",
        "  at 100 Hz period error 7.96 / 8.00 -> 1.99 / 2.00 ms, missed 4 -> 1, "
        "age 12.0 / 12.0 -> 3.00 / 3.00 ms",
        f"mlockall refused: {refused[1]}",
        "100 Hz, SCHED_FIFO: a job would have been ended: the computer is too slow",
    ]


def test_turns_are_added_up_and_written_in_milliseconds():
    one = Measured(Setting("ordinary", ()), 50.0)
    for missed in (1, 2):
        timing = Timing(0.02, None, missed=missed, page_faults=7, disk_faults=1)
        timing.add(1e-3, 2e-3)
        timing.add(4e-3, 2e-3)
        one.add(timing)
    figures = one.as_json()
    assert json.loads(json.dumps(figures)) == figures
    assert (figures["ticks"], figures["missed"]) == (4, 3)
    assert (figures["page_faults"], figures["disk_faults"]) == (14, 2)
    assert figures["late_max_ms"] == pytest.approx(4.0)
    assert figures["period_error_p50_ms"] == pytest.approx(3.0)
    assert figures["ages_p99_ms"] is None  # a simulation has none


def test_a_refused_privilege_is_measured_all_the_same(work, monkeypatch, capsys):
    def refuse(self, priority):
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(Kernel, "is_fifo", lambda self: False)
    monkeypatch.setattr(Kernel, "set_fifo", refuse)
    monkeypatch.setattr("parapod.sims.real_machine.deadlines._ALONE", 0.1)
    monkeypatch.setenv("COLUMNS", "80")
    command = "bench-rt --rates 50 --seconds 1 --settings --json figures.json"
    monkeypatch.setattr("parapod.sims.real_machine.deadlines.SIDE_BY_SIDE", settings_of(0, 0))
    assert main(command.split()) == 0
    out = capsys.readouterr().out
    assert "SCHED_FIFO refused: EPERM; the limit rtprio is " in " ".join(out.split())
    assert out.splitlines()[0].startswith("kernel ")
    assert "real-time programs: " in out
    assert max(map(len, out.splitlines())) <= 80
    written = json.loads((work / "figures.json").read_text())
    assert {"computer", "settings", "throttling"} <= written.keys()
    (one,) = written["settings"]
    assert (one["asked"], one["ticks"]) == (list(USUAL), 50)
    assert os.listdir(work) == ["figures.json"]


# --- on emulated devices


def has_libraries():
    for library in ("nidaqmx", "grpc", "canopen", "can", "serial", "mcap"):
        pytest.importorskip(library)


# With these words the program refuses a computer that is too busy.
TOO_BUSY = ("does not answer", "measurements would be up to")


@pytest.mark.parametrize("options", ["", pytest.param("--log", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["level", pytest.param("chair-walk", marks=pytest.mark.slow)])
def test_the_path_through_devices_is_measured_on_an_emulator_of_its_own(
    work, monkeypatch, capsys, in_time, judge, name, options
):
    has_libraries()
    monkeypatch.setenv("PARAPOD_EMULATOR", "/nowhere")  # of somebody else
    monkeypatch.setattr("parapod.sims.real_machine.deadlines._ALONE", 0.1)
    command = f"bench-rt --of {name} --backend hardware --seconds 1 {options} --json figures.json"
    with judge() as judged:
        code = main(command.split())
    out, said = capsys.readouterr()
    if code and any(words in said for words in TOO_BUSY) and judged.late > 0.1:
        pytest.skip(f"{said.splitlines()[-1]}; the machine was late by {judged.late:.3f} s")
    assert code == 0, said
    assert "age at write" in out
    assert os.environ["PARAPOD_EMULATOR"] == "/nowhere"
    for one in json.loads((work / "figures.json").read_text())["settings"]:
        in_time(float(len(one["ended_early"])), 1.0, f"turns that were ended {one['ended_early']}")
        assert one["ticks"] + one["missed"] >= 95
        in_time(one["ages_p50_ms"], 20.0, "median age of measurements at the write [ms]")


@pytest.mark.slow
def test_a_device_that_is_not_the_emulators_is_refused_before_anything_is_opened():
    has_libraries()
    scenario = LevellingScenario(backend="hardware")
    scenario.hardware.drivers[0].target = "unix:/run/laboratory.sock"
    with pytest.raises(OutputError, match=r"emulator does not begin: .*is not an address of"):
        compare_settings(
            PLATFORM, "level", scenario, [100.0], 1.0, settings_of(False, False), QUIET
        )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_the_emulator_ends_with_the_measurement_however_that_ends(name):
    has_libraries()
    program = subprocess.Popen(
        [sys.executable, "-m", "parapod.sims", "bench-rt", "--backend=hardware", "--seconds=60"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    signal_of_children = f"/proc/{program.pid}/task/{program.pid}/children"
    try:
        deadline, children = time.monotonic() + 60.0, []
        while not children and time.monotonic() < deadline:
            time.sleep(0.1)
            with open(signal_of_children) as file:
                children = [int(pid) for pid in file.read().split()]
        time.sleep(5.0)
        program.send_signal(getattr(signal, name))
        program.wait(600.0)
        deadline = time.monotonic() + 60.0
        while any(map(lives, children)) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert children
        assert not any(map(lives, children))
    finally:
        program.kill()


def lives(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False
