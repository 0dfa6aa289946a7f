"""The `parapod` command, with an experiment that is a few lines long."""

import io
import json
import subprocess
import sys
import time
from dataclasses import dataclass, field
from importlib.metadata import version

import pytest
from rich.console import Console

from parapod.sims.cli.main import main
from parapod.sims.lab.experiment import ENTRIES, Entry, Experiment, experiments, progress
from parapod.sims.lab.files import atomic_output
from parapod.sims.lab.results import Metric, Result
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.schema import Schema, choice, quantity


@dataclass
class Ground(Schema):
    pitch_deg: float = quantity(5.0, -15.0, 15.0)


@dataclass
class Scenario(Schema):
    backend: str = choice("kinematic", ("kinematic", "multibody", "mock"))
    seed: int = quantity(0, 0, 1000)
    ground: Ground = field(default_factory=Ground)


@pytest.fixture
def runs():
    """What the experiment was run with."""
    return []


@pytest.fixture
def behaviour():
    """Put a function here to have it called within the run."""
    return []


@pytest.fixture
def parapod(tmp_path, monkeypatch, runs, behaviour):
    """The command with one experiment `tilt`, in an empty folder."""

    def run(scenario, options):
        runs.append((scenario, options))
        for act in behaviour:
            act(options)
        metric = Metric("tilt", scenario.ground.pitch_deg, "deg", 10.0, meaning="the ground's")
        return Result("tilt", scenario.backend, scenario.seed, (metric,))

    experiment = Experiment("tilt", "Tilts.", Scenario, ("kinematic", "multibody"), run)
    folder = tmp_path / "scenarios"
    folder.mkdir()
    (folder / "tilt.yaml").write_text("seed: 7\n")
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    entries = (Entry("tilt", "Tilts.", lambda: experiment, folder),)
    return lambda *argv: main(argv, entries)


@pytest.fixture
def refused(parapod, capsys, tmp_path):
    """The one line that a mistaken command line is answered with."""

    def run(*argv):
        assert parapod(*argv) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1
        assert err.startswith("parapod: error: ")
        assert list((tmp_path / "work").glob("*")) == []
        return err.removeprefix("parapod: error: ").rstrip()

    return run


def test_list_names_every_experiment_with_its_summary(parapod, capsys):
    assert parapod("list") == 0
    assert capsys.readouterr().out == "tilt  Tilts.\n"


def test_bounds_that_hold_are_exit_code_0(parapod, capsys):
    assert parapod("run", "tilt") == 0
    out, err = capsys.readouterr()
    assert "tilt (kinematic, seed 7)" in out
    assert "all bounds held" in out
    assert err == ""


def test_a_broken_bound_is_exit_code_1_and_named(parapod, capsys):
    assert parapod("run", "tilt", "--set", "ground.pitch_deg=12", "--json", "x.json") == 1
    assert "broken: tilt = 12 deg (bound 10 deg)" in capsys.readouterr().out
    with open("x.json") as stream:
        assert json.load(stream)["passed"] is False


def test_arguments_reach_the_experiment(parapod, runs, tmp_path):
    (tmp_path / "mine.yaml").write_text("ground: {pitch_deg: 1}\nseed: 1\n")
    options = "--meshcat --no-live --html a.html --log b.npz --graphviz c.dot --backend multibody"
    assert (
        parapod("run", "tilt", "--scenario", "../mine.yaml", "--seed", "3", *options.split()) == 0
    )
    (scenario, run_options), *_ = runs
    assert scenario == Scenario("multibody", 3, Ground(1.0))
    assert (run_options.meshcat, run_options.live) == (True, False)
    paths = (run_options.html, run_options.log, run_options.graphviz)
    assert [str(path) for path in paths] == ["a.html", "b.npz", "c.dot"]


def test_set_takes_several_values_and_may_be_repeated(parapod, runs):
    parapod("run", "tilt", "--set", "seed=1", "ground.pitch_deg=-2", "--set", "seed=2")
    assert runs[0][0] == Scenario(seed=2, ground=Ground(-2.0))


def test_seed_and_backend_win_over_set(parapod, runs):
    parapod("run", "tilt", "--seed", "3", "--set", "seed=4")
    assert runs[0][0].seed == 3


def test_the_same_arguments_give_the_same_json(parapod, tmp_path):
    for name in ("a.json", "b.json"):
        parapod("run", "tilt", "--json", name)
    first, second = (tmp_path / "work" / name for name in ("a.json", "b.json"))
    assert first.read_bytes() == second.read_bytes()
    assert json.loads(first.read_text()) == {
        "experiment": "tilt",
        "backend": "kinematic",
        "seed": 7,
        "passed": True,
        "tilt": 5.0,
    }


def test_scenario_prints_what_run_would_use_and_run_accepts_it(parapod, capsys, runs):
    assert parapod("scenario", "tilt", "--set", "ground.pitch_deg=2") == 0
    text = capsys.readouterr().out
    assert text.startswith("# parapod run tilt: Tilts. ")
    assert "seed: 7             # (0..1000)\n" in text
    assert "\nground:\n  pitch_deg: 2.0  # (-15..15)\n" in text
    with open("mine.yaml", "w") as stream:
        stream.write(text)
    parapod("run", "tilt", "--scenario", "mine.yaml")
    assert runs[0][0] == Scenario(seed=7, ground=Ground(2.0))


# Mistakes


def test_an_unknown_experiment_is_answered_with_the_known_ones(refused):
    assert refused("run", "titl") == (
        "there is no experiment 'titl'; there are: tilt (did you mean tilt?)"
    )


@pytest.mark.parametrize("command", ["run", "scenario"])
@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ("--set ground.pich_deg=1", "unknown key 'ground.pich_deg'; allowed under 'ground': "),
        ("--set ground.pitch_deg=40", "ground.pitch_deg = 40 is outside -15..15"),
        ("--set ground.pitch_deg", "override 'ground.pitch_deg' is not of the form key=value"),
        ("--seed x", "seed must be a whole number, not 'x'"),
        ("--seed -1", "seed = -1 is outside 0..1000"),
        (
            "--backend kinmatic",
            "backend = 'kinmatic' is not one of kinematic, multibody, mock (did",
        ),
        ("--backend mock", "backend = 'mock' is not one on which 'tilt' runs; there are: kinemat"),
        ("--scenario x.yaml", "scenario file 'x.yaml' does not exist"),
    ],
)
def test_a_wrong_scenario_is_refused_before_the_run(refused, runs, command, arguments, text):
    assert refused(command, "tilt", *arguments.split()).startswith(text)
    assert runs == []


@pytest.mark.parametrize("option", ["--html", "--json", "--log", "--graphviz"])
def test_a_path_that_cannot_be_written_is_refused_before_the_run(refused, runs, option):
    text = refused("run", "tilt", option, "out/x")
    assert text == "cannot write 'out/x': the folder 'out' does not exist"
    assert "it is a directory" in refused("run", "tilt", option, "")
    assert runs == []


def test_one_path_for_two_outputs_is_refused(refused):
    text = refused("run", "tilt", "--json", "x", "--log", "./x")
    assert text == "--json and --log would both write 'x'"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ("run", "the following arguments are required: NAME (see parapod run --help)"),
        ("run tilt --sed 3", "unrecognized arguments: --sed 3 (see parapod --help)"),
        ("run tilt --set", "argument --set: expected at least one argument (see parapod run"),
        ("walk", "argument COMMAND: invalid choice: 'walk'"),
    ],
)
def test_a_wrong_command_line_is_one_line(refused, arguments, text):
    assert refused(*arguments.split()).startswith(text)


_LONG = "x" * 10_000


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["list", "\n"], "unrecognized arguments: \\n (see parapod --help)"),
        (["list", _LONG], "unrecognized arguments: xxx"),
        (["wa\nlk"], "argument COMMAND: invalid choice: 'wa\\nlk'"),
        ([_LONG], "argument COMMAND: invalid choice: 'xxx"),
        (["run", "a\nb"], "there is no experiment 'a\\nb'; there are: tilt"),
        (["run", "\x1b[31m"], "there is no experiment '\\x1b[31m'; there are: tilt"),
        (["run", _LONG], "there is no experiment 'xxx"),
        (["run", "tilt", "--set", "x\ny=1"], "unknown key 'x\\ny'; allowed: backend, "),
        (["run", "tilt", "--set", f"{_LONG}=1"], "unknown key 'xxx"),
        (["run", "tilt", "--set", f"ground.{_LONG}=1"], "unknown key 'ground.xxx"),
        (["run", "tilt", "--set", "a\tb"], "override 'a\\tb' is not of the form key=value"),
        (["run", "tilt", "--backend", "a\nb"], "backend = 'a b' is not one of kinematic, "),
        (["run", "tilt", "--seeds", "1\n2"], "argument --seeds: must be a whole number of 1 or"),
        (["run", "tilt", "--seeds", "9" * 10_000], "argument --seeds: "),
        (["run", "tilt", "--scenario", "a\nb"], "scenario file 'a\\nb' does not exist"),
        (["run", "tilt", "--scenario", _LONG], "scenario file 'xxx"),
        (["run", "tilt", "--json", "a\n/b"], "cannot write 'a\\n/b': the folder 'a\\n' does not"),
        (["run", "tilt", "--json", _LONG], "cannot write 'xxx"),
        (["run", "tilt", "--drivers", "a\nb"], "drivers 'a\\nb': there is no such Python file"),
        (["bench-rt", "--of", "a\nb"], "there is no experiment 'a\\nb'; there are: tilt"),
        (["check", "le\ngs", "--of", _LONG], "there is no experiment 'xxx"),
    ],
    ids=lambda value: " ".join(value)[:30] if isinstance(value, list) else "",
)
def test_whatever_is_typed_an_error_is_one_line_of_reasonable_length(refused, arguments, text):
    said = refused(*arguments)
    assert said.startswith(text)
    assert said.isprintable()
    assert len(said) < 500


# Runs that fail


def half_written(error):
    def act(options):
        with atomic_output(options.html) as temporary:
            temporary.write_text("half")
            raise error

    return act


def test_an_error_of_parapod_within_the_run_is_one_line_and_leaves_nothing(refused, behaviour):
    behaviour.append(half_written(ParapodError("leg 2 is stuck")))
    assert refused("run", "tilt", "--html", "x.html", "--json", "x.json") == "leg 2 is stuck"


def test_control_c_is_exit_code_130_without_a_traceback_and_leaves_nothing(
    parapod, behaviour, capsys, tmp_path
):
    behaviour.append(half_written(KeyboardInterrupt()))
    assert parapod("run", "tilt", "--html", "x.html", "--json", "x.json") == 130
    assert capsys.readouterr() == ("", "parapod: interrupted\n")
    assert list((tmp_path / "work").iterdir()) == []


def test_a_bug_keeps_its_traceback_and_leaves_nothing(parapod, behaviour, tmp_path):
    behaviour.append(half_written(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        parapod("run", "tilt", "--html", "x.html", "--json", "x.json")
    assert list((tmp_path / "work").iterdir()) == []


def test_the_table_is_printed_even_if_the_json_cannot_be_written(
    parapod, behaviour, capsys, tmp_path
):
    behaviour.append(lambda options: (tmp_path / "work" / "x.json").mkdir())
    assert parapod("run", "tilt", "--json", "x.json") == 2
    out, err = capsys.readouterr()
    assert "all bounds held" in out
    assert err == "parapod: error: cannot write 'x.json': it is a directory\n"


# The command as it is installed


@pytest.mark.parametrize("arguments", [["list"], ["--version"], ["run", "nothing"]])
def test_what_needs_no_drake_does_not_import_it(arguments):
    code = (
        "import sys; from parapod.sims.cli.main import main; main(sys.argv[1:]); "
        "sys.exit(bool({'pydrake', 'numpy', 'scipy'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code, *arguments]).returncode == 0


def test_the_module_is_the_command():
    command = [sys.executable, "-m", "parapod.sims"]
    done = subprocess.run([*command, "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"parapod {version('parapod')}\n")
    done = subprocess.run([*command, "run", "levle"], capture_output=True, text=True)
    assert done.returncode == 2
    assert "did you mean level?" in done.stderr


@pytest.mark.parametrize("arguments", [[], ["--help"], ["run", "--help"], ["scenario", "--help"]])
def test_help_has_examples(arguments, capsys):
    try:
        code = main(arguments)
    except SystemExit as stop:
        code = stop.code
    assert code == 0
    assert "parapod run level --set" in capsys.readouterr().out


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_an_entry_tells_what_its_experiment_tells(entry):
    experiment = experiments([entry])[entry.name]
    assert (experiment.name, experiment.summary) == (entry.name, entry.summary)
    assert entry.default_scenario is None or entry.default_scenario.is_file()


# Progress


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
