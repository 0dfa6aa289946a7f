"""Studies: the rows of their table, what is refused, and what survives."""

import fcntl
import io
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import count

import numpy as np
import pyarrow.parquet
import pytest
from rich.console import Console

import parapod
from parapod.sims.cli.main import main
from parapod.sims.lab.discovery import find_experiment
from parapod.sims.lab.work import Crew, LocalCrew, NoWorkers
from parapod.sims.output.options import Loops, RunOptions
from parapod.sims.study.records import Records
from parapod.sims.study.result import read_study
from parapod.sims.study.runs import AnotherVersion, Software, carry_out_runs
from parapod.sims.study.study import Study
from parapod.sims.study.summary import print_summary
from parapod.systems.core.errors import OutputError
from tests.sims.study.conftest import Here, carry_out

XY = {"x": "-2:2:5", "y": "-2:2:3"}
ALL = {"x": "-1:2:4", "y": "-2:2:3", "kind": "good,refused,crash"}


def rows(path):
    return pyarrow.parquet.read_table(path).to_pylist()


# --- the table


def test_texts_of_a_key_are_compared_side_by_side(study):
    done = carry_out(study({"x": "2,4,8", "note": ",other", "kind": "good,refused"}))
    empty, other = (one.values for one in done.summary.comparisons)
    assert (empty, other) == (("''", "other"), ("good", "refused"))
    by_note, by_kind = done.summary.comparisons
    assert by_note.medians["total_mm"] == (4.0, 4.0)
    assert by_kind.medians["total_mm"][0] == 4.0
    assert np.isnan(by_kind.medians["total_mm"][1])
    assert [runs for _, runs in by_kind.passed] == [6, 6]
    assert by_kind.passed[1][0] == 0
    stream = io.StringIO()
    print_summary(done.summary, Console(file=stream, width=100))
    assert "medians by note" in stream.getvalue()
    assert done.summary.as_json()["comparisons"]["kind"]["refused"]["medians"]["total_mm"] is None
    assert "Medians by kind" in done._repr_html_()
    assert " note= " in done.summary.commands[0] + " "


def test_a_row_has_the_variables_the_metrics_and_what_became_of_the_bounds(study, work):
    path = work / "xy.parquet"
    carry_out(study(XY), path)
    found = rows(path)
    assert [row["run"] for row in found] == list(range(15))
    assert list(found[0]) == [
        *("run", "x", "y", "total_mm", "floor_mm", "own_mm", "own_mm.bound"),
        *("passed", "broken", "error"),
    ]
    for row in found:
        x, y = row["x"], row["y"]
        assert (row["total_mm"], row["floor_mm"]) == (x + 2.0 * y, y)
        assert row["own_mm"] == (x if x > 0.0 else None)
        assert row["own_mm.bound"] == (1.0 + abs(y) if x > 0.0 else None)
        broken = [
            *(["total_mm"] if abs(x + 2.0 * y) > 5.0 else []),
            *(["floor_mm"] if y < -1.0 else []),
            *(["own_mm"] if x > 1.0 + abs(y) else []),
        ]
        assert row["broken"] == ", ".join(broken)
        assert row["passed"] == (not broken)
    assert list(work.iterdir()) == [path]


def test_what_the_clock_measures_is_no_column(study):
    assert "clock_s" not in carry_out(study(XY)).table.column_names


def test_a_run_that_is_refused_or_fails_is_a_row_with_its_reason(study):
    result = carry_out(study({"kind": "good,refused,crash", "x": "1,2"}))
    assert result["error"].tolist() == [
        *("", ""),
        *("x = 1 is refused", "x = 2 is refused"),
        *["RuntimeError: it does not converge"] * 2,
    ]
    assert result["passed"].tolist() == [True, False, False, False, False, False]
    assert np.isnan(result["total_mm"][2:]).all()
    refusals = result.summary.refusals
    assert refusals == (
        ("x = 1 is refused", 2, 2),
        ("RuntimeError: it does not converge", 2, 4),
    )


def test_pandas_and_polars_read_the_result(study):
    result = carry_out(study(XY))
    again = pyarrow.table(result)  # through the interface that both use
    assert again.equals(result.table)
    assert len(result) == 15
    with pytest.raises(KeyError, match="no column 'z'; there are: run, x, y, total_mm"):
        result["z"]


def test_a_table_gives_the_result_again(study, work):
    path = work / "all.parquet"
    result = carry_out(study(ALL), path)
    again = read_study(path)
    assert again.table.equals(result.table, check_metadata=True)
    assert again.summary.as_json() == result.summary.as_json()


def test_columns_come_in_the_order_in_which_runs_measure_them_whichever_is_done_first(study):
    made = study(XY)
    result = carry_out(made)
    records = Records(made.sampling)
    for run in reversed(range(15)):
        records.add(*carry_out_runs(made.order, 1, [(run, made.sampling.values(run))]))
    assert [c.key for c in records.columns] == [c.key for c in result.records.columns]


# --- its summary


def test_a_command_repeats_the_worst_run_of_each_metric(study):
    result = carry_out(study({"x": "normal(0, 2)", "y": "-1:1", "seed": "3:9"}, "latin", 8, 5))
    for metric in result.summary.metrics:
        if metric.worst is None:
            continue
        command = shlex.split(result.summary.commands[metric.worst])
        assert command[:4] == ["parapod", "run", "trial", "--set"]
        scenario = parapod.scenario("trial", *command[4:])
        value = result[metric.key][metric.worst]
        assert parapod.run(scenario, quiet=True)[metric.key] == value


def test_a_command_names_all_that_differs_from_the_default(study):
    made = study({"x": "1:2:2"}, y=2.5, seed=7)
    assert made.command(1) == "parapod run trial --set seed=7 y=2.5 x=2.0"


def test_quantiles_are_those_of_the_runs(study):
    summary = carry_out(study({"x": "-2:2:101"})).summary
    total = summary.metrics[0]
    assert list(total.quantiles.values()) == pytest.approx([-2.0, -1.8, 0.0, 1.8, 2.0], abs=1e-12)
    assert (total.held, total.measured, total.limits) == (101, 101, "<= 5")
    own = summary.metrics[2]
    assert (own.held, own.measured, own.limits) == (25, 50, "<= 1")
    assert (own.worst, own.use) == (100, 2.0)
    assert summary.passed == 76
    (total, *_) = carry_out(study({"x": "0:3:4"})).summary.metrics
    assert list(total.quantiles.values()) == [0.0, 0.0, 1.0, 3.0, 3.0]  # of values that there are


# --- refused


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("trial", "a study varies at least one key"),
        ("trial --vary x=0:1:2 x=3", "--vary gives x twice"),
        ("trial --vary x", "is not of the form KEY=VALUES"),
        ("trial --vary z=1", "unknown key 'z'"),
        ("trial --vary x=0:1:2 --runs 3", "the grid has 2 runs, not 3"),
        ("trial --vary x=0:1:2 --resume", "name it with --out"),
        ("trial --vary x=0:1:2 --workers 0", "must be a whole number of 1 or more"),
        ("trial --vary x=0:1:2 --workers 2 --cluster tcp://localhost:1", "has its own"),
        ("trial --vary x=0:1:2 --out a.csv", "the table of a study is a .parquet file"),
        ("trial --vary x=0:1:2 --out no/a.parquet", "the folder 'no' does not exist"),
        ("trial --vary backend=exact,hardware", "one of its backends is hardware"),
        ("trial --vary x=0:1:2 --drivers a.py", "--drivers is for hardware"),
        ("nothing --vary x=0:1:2", "there is no experiment 'nothing'"),
    ],
)
def test_a_mistake_is_told_in_one_line_and_leaves_nothing(trial, work, capsys, arguments, words):
    assert main(["study", *arguments.split()]) == 2
    said = capsys.readouterr().err
    assert said.startswith("parapod: error: ")
    assert words in said
    assert said.count("\n") == 1
    assert list(work.iterdir()) == []


def test_a_file_that_is_there_is_left_as_it_is(study, work):
    path = work / "xy.parquet"
    carry_out(study(XY), path)
    before = path.read_bytes()
    with pytest.raises(OutputError, match="is there already: --resume goes on"):
        carry_out(study(XY), path)
    assert path.read_bytes() == before
    assert list(work.iterdir()) == [path]


@pytest.mark.parametrize(
    ("vary", "sampling", "settings", "words"),
    [
        ({"x": "-2:2:5"}, (), {}, "there variables.y = '-2:2:3', here null"),
        (XY | {"y": "0:1:3"}, (), {}, "there variables.y = '-2:2:3', here '0:1:3'"),
        (XY, ("latin", 15), {}, "there sampling = 'grid', here 'latin'"),
        (XY, (), {"wait": 0.5}, "there scenario.wait = 0, here 0.5"),
    ],
)
def test_a_file_of_another_study_is_left_as_it_is(study, work, vary, sampling, settings, words):
    path = work / "xy.parquet"
    carry_out(study(XY), path)
    before = path.read_bytes()
    with pytest.raises(OutputError) as caught:
        carry_out(study(vary, *sampling, **settings), path, resume=True)
    assert f"{path}' is of another study: {words}" in str(caught.value)
    assert path.read_bytes() == before


def test_a_file_of_other_software_is_not_gone_on_with(study, work):
    path, made = work / "xy.parquet", study(XY)
    carry_out(made, path)
    newer = replace(made, software=replace(made.software, parapod="9.9 (0)"))
    with pytest.raises(OutputError, match=r"there software.parapod = .*, here '9.9 \(0\)'"):
        carry_out(newer, path, resume=True)


@pytest.mark.parametrize("content", [b"", b"PAR1 and so on", b"{}"])
def test_a_file_that_is_no_table_is_left_as_it_is(study, work, content):
    path = work / "xy.parquet"
    path.write_bytes(content)
    with pytest.raises(OutputError, match="it is not a Parquet file"):
        carry_out(study(XY), path, resume=True)
    assert path.read_bytes() == content
    assert list(work.iterdir()) == [path]
    pyarrow.parquet.write_table(pyarrow.table({"run": [1]}), path)
    with pytest.raises(OutputError, match="is not the table of a study"):
        read_study(path)


def test_two_studies_do_not_write_one_file(study, work):
    path = work / "xy.parquet"
    with open(f"{path}.journal", "wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        for resume in (False, True):
            with pytest.raises(OutputError, match="another study is being written to"):
                carry_out(study(XY), path, resume)
    assert not path.exists()


def test_a_worker_of_another_version_ends_the_study_in_one_line(study, work):
    made = study(XY)
    older = replace(made, software=Software("trials 0.9", "0.0.9 (0)", "1.0"))
    with pytest.raises(
        AnotherVersion, match=r"has trials 1.0, parapod .*; here is trials 0.9, pa"
    ):
        carry_out(older, work / "xy.parquet")
    assert list(work.iterdir()) == []


def test_an_executor_that_is_shut_down_ends_the_study(study):
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(1)
    pool.shutdown()
    with pytest.raises(NoWorkers, match="takes no more work"):
        carry_out(study(XY), crew=Crew(pool, 1))


# --- survives


class Fails(Here):
    """Breaks off after some runs."""

    def __init__(self, after, error):
        self._left, self._error = after, error

    def submit(self, function, /, *arguments, **options):
        self._left -= 1
        if self._left < 0:
            raise self._error
        return super().submit(function, *arguments, **options)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), NoWorkers("gone")])
def test_a_study_that_is_broken_off_is_gone_on_with(study, work, error):
    path, whole = work / "xy.parquet", carry_out(study(XY))
    with pytest.raises(type(error)):
        carry_out(study(XY), path, crew=Crew(Fails(3, error), 1))
    done = rows(path)
    assert 0 < len(done) < 15
    assert list(work.iterdir()) == [path]
    result = carry_out(study(XY), path, resume=True)
    assert result.table.equals(whole.table, check_metadata=True)


def test_what_is_done_is_not_done_again(study, work):
    path = work / "xy.parquet"
    carry_out(study(XY), path)
    result = carry_out(study(XY), path, resume=True, crew=Crew(Fails(0, NoWorkers("gone")), 1))
    assert len(result) == 15


@pytest.mark.parametrize("cut", [1, 40, 100_000])
def test_a_journal_that_is_cut_off_counts_as_far_as_it_is_complete(study, work, cut):
    """Twice, as after a power failure: no table, and the last line is in part there."""
    path, whole = work / "xy.parquet", carry_out(study(XY))
    journal, copy = work / "xy.parquet.journal", work / "copy"
    for resume, sent in ((False, 3), (True, 3)):
        with pytest.raises(NoWorkers):
            carry_out(study(XY), path, resume, crew=Crew(Copies(journal, sent), 1))
        path.unlink()
        journal.write_bytes(copy.read_bytes()[:-cut])
    complete = len(re.findall(rb'^{"run".*\n', journal.read_bytes(), re.MULTILINE))
    console = Console(file=io.StringIO(), force_terminal=True, width=80)
    result = carry_out(study(XY), path, resume=True, console=console)
    assert result.table.equals(whole.table, check_metadata=True)
    assert not journal.exists()
    done = min(map(int, re.findall(r"(\d+) of 15", console.file.getvalue())))
    assert done == complete
    assert (done == 0) == (cut > 1000)


class Copies(Fails):
    """Copies the journal as it is in the midst of a study, and breaks off."""

    def __init__(self, journal, after):
        super().__init__(after, NoWorkers("gone"))
        self._journal = journal

    def submit(self, *arguments, **options):
        self._journal.with_name("copy").write_bytes(self._journal.read_bytes())
        return super().submit(*arguments, **options)


def test_loops_that_serve_many_runs_give_what_single_runs_give(monkeypatch):
    """Grounds, seeds and dimensions of the platform, one after the other and in another order."""
    experiment = find_experiment("level")
    brief = ("backend=kinematic", "job.estimate_at=0.5", "job.end=2", "job.settled_after=0.5",
             "job.waypoints=[]", "job.arm={start: 0.5, duration: 0.5}")  # fmt: skip
    runs = [
        ("seed=1", "ground.pitch_deg=1"),
        ("seed=2", "ground.roll_deg=-1", "machine.sensors.accel_bias_mg=3"),
        ("seed=2", "plant.length_error_mm=0.2"),
        ("seed=3", "plant.length_error_mm=0.2", "job.initial_extension_mm=404"),
    ]
    built = count()
    original = type(experiment).loop
    monkeypatch.setattr(
        type(experiment), "loop", lambda *a, **o: (next(built), original(*a, **o))[1]
    )
    monkeypatch.setattr(type(experiment), "structure", _structure)
    quiet = {"console": Console(quiet=True)}

    def values(run, **options):
        scenario = parapod.scenario("level", *brief, *run)
        result = experiment.execute(scenario, RunOptions(**quiet, **options))
        return [m.value for m in result.metrics if not m.is_timing]

    alone = [values(run) for run in runs]
    assert next(built) == 4
    loops = Loops()
    for order in (range(4), reversed(range(4))):
        for i in order:
            assert values(runs[i], loops=loops) == alone[i]
    assert next(built) == 4 + 1 + 3


def test_only_so_many_loops_are_kept(monkeypatch):
    made = []
    monkeypatch.setattr(Loops, "_MOST", 2)
    loops = Loops()
    for structure, built in (("a", 1), ("b", 2), ("a", 2), ("c", 3), ("a", 3), ("b", 4)):
        loops.loop(structure, lambda: made.append(0) or object())
        assert len(made) == built


def test_runs_of_one_structure_follow_each_other():
    scenario = parapod.scenario("level", "backend=kinematic")
    vary = {"seed": "0:2", "job.height_mm": "476,478", "ground.pitch_deg": "1,2"}
    study = Study.make("level", scenario, vary)
    order = study._in_order(np.arange(8))
    heights = [study.sampling.values(run)[1] for run in order]
    assert heights == [476] * 4 + [478] * 4
    assert order == [0, 1, 4, 5, 2, 3, 6, 7]


def test_the_table_can_be_read_in_the_midst_of_a_study(study, work, monkeypatch):
    monkeypatch.setattr("parapod.sims.study.file._WRITE_PERIOD", 0.0)
    monkeypatch.setattr("parapod.sims.study.file._WRITE_SHARE", 1e9)
    path, seen = work / "xy.parquet", []

    class Reads(Here):
        def submit(self, *arguments, **options):
            seen.append(len(rows(path)))
            return super().submit(*arguments, **options)

    carry_out(study(XY), path, crew=Crew(Reads(), 1))
    assert seen[0] == 0
    assert seen == sorted(seen)
    assert seen[-1] > 5


def _structure(experiment, scenario):
    return experiment.machine.structure(scenario)


# --- in processes


@pytest.fixture
def importable(trial, monkeypatch):
    """Programs that tests begin find the package of the trial too."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path[:1]))


SLOW = {"x": "-2:2:6", "y": "-2:2:4", "wait": "0.05"}


def test_two_workers_one_of_whom_is_killed_give_the_rows_of_one(study, work):
    """And a run that kills its worker is a row, the others are done."""
    path, whole = work / "slow.parquet", carry_out(study(SLOW))
    with LocalCrew(2) as crew:
        killed, submit = [], crew.executor.submit

        def kill_one(*arguments):
            if not killed and len(rows_so_far(path)) > 2:
                killed.append(next(iter(crew.executor._processes)))
                os.kill(killed[0], signal.SIGKILL)
            return submit(*arguments)

        crew.executor.submit = kill_one
        result = carry_out(study(SLOW), path, crew=crew)
        lethal = carry_out(study({"kind": "lethal,good"}), crew=crew)
    assert killed
    assert result.table.equals(whole.table, check_metadata=True)
    assert lethal["error"][0].startswith("the process that carried it out died")
    assert lethal["total_mm"][1:].tolist() == [0.0]


def rows_so_far(path):
    journal = path.with_name(f"{path.name}.journal")
    if not journal.exists():
        return []
    return [line for line in journal.read_bytes().split(b"\n") if line.startswith(b'{"run"')]


def test_a_study_whose_program_is_killed_is_gone_on_with(study, importable, work):
    path, whole = work / "slow.parquet", carry_out(study(SLOW))
    vary = [f"{key}={text}" for key, text in SLOW.items()]
    program = [sys.executable, "-m", "parapod.sims", "study", "trial", "--vary", *vary]
    options = ["--out", str(path), "--workers", "2"]
    said = path.with_suffix(".txt")
    with (
        said.open("w") as stream,
        subprocess.Popen([*program, *options], stderr=stream) as process,
    ):
        until = time.monotonic() + 600.0
        while len(rows_so_far(path)) < 4:
            assert time.monotonic() < until
            assert process.poll() is None, said.read_text()
            time.sleep(0.02)
        workers = children(process.pid)
        process.kill()
    assert workers
    until = time.monotonic() + 120.0
    while any(os.path.exists(f"/proc/{worker}") for worker in workers):
        assert time.monotonic() < until, "workers outlive the program"
        time.sleep(0.05)
    done = len(rows_so_far(path))
    assert 4 <= done < 24
    assert len(rows(path)) <= done  # the table can be read at any time
    result = carry_out(study(SLOW), path, resume=True)
    assert result.table.equals(whole.table, check_metadata=True)


def children(pid):
    with open(f"/proc/{pid}/task/{pid}/children") as file:
        return [int(word) for word in file.read().split()]
