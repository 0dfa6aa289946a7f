"""The `parapod` command, with an experiment of another package that is a few lines long."""

import json
import re
import shlex
import subprocess
import sys
from importlib.metadata import version

import pytest
import yaml

from parapod.diagrams.machine import find_machine
from parapod.sims.cli.main import COMMANDS, GROUPS, main, make_parser
from parapod.sims.output.atomic import atomic_output
from parapod.systems.core.errors import ParapodError


@pytest.fixture
def runs(pendula, work, monkeypatch):
    """Scenarios and options with which `swing` was run."""
    seen = []
    execute = pendula.execute

    def remembered(experiment, scenario, options):
        seen.append((scenario, options))
        return execute(experiment, scenario, options)

    monkeypatch.setattr(pendula, "execute", remembered)
    return seen


def test_bounds_that_hold_are_exit_code_0(runs, capsys):
    assert main(["run", "swing", "--seed", "7"]) == 0
    out, err = capsys.readouterr()
    assert "swing (exact, seed 7)" in out
    assert "all bounds held: 1 of 1" in out
    assert err == ""


def test_a_broken_bound_is_exit_code_1_and_named(runs, capsys):
    assert main(["run", "swing", "--set", "length_m=4", "--json", "x.json"]) == 1
    assert "broken: period_s = 4.0121 s (bound 2.5 s)" in capsys.readouterr().out
    with open("x.json") as stream:
        assert json.load(stream)["passed"] is False


def test_arguments_reach_the_experiment(runs, tmp_path):
    (tmp_path / "mine.yaml").write_text("length_m: 0.5\nseed: 1\n")
    command = "run swing --scenario ../mine.yaml --heavy --no-live --log b.npz --graphviz c.dot"
    assert main([*command.split(), "--seed", "3", "--backend", "exact"]) == 0
    ((scenario, options),) = runs
    assert (scenario.length_m, scenario.seed, scenario.heavy) == (0.5, 3, True)
    assert (options.meshcat, options.live, options.html) == (False, False, None)
    assert [str(path) for path in (options.log, options.graphviz)] == ["b.npz", "c.dot"]


def test_set_takes_several_values_and_may_be_repeated_and_options_win(runs):
    main(["run", "swing", "--set", "seed=1", "length_m=2", "--set", "seed=2"])
    main(["run", "swing", "--seed", "3", "--set", "seed=4"])
    assert [(s.seed, s.length_m) for s, _ in runs] == [(2, 2.0), (3, 0.25)]


def test_the_same_arguments_give_the_same_json(runs, work):
    for name in ("a.json", "b.json"):
        main(["run", "swing", "--json", name])
    assert (work / "a.json").read_bytes() == (work / "b.json").read_bytes()


def test_scenario_prints_what_run_would_use_and_run_accepts_it(runs, capsys, work):
    assert main(["scenario", "swing", "--set", "seed=2"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("# parapod run swing: Swing a pendulum and count its periods. ")
    assert yaml.safe_load(text) == {
        "backend": "exact",
        "seed": 2,
        "length_m": 0.25,
        "heavy": False,
    }
    (work / "mine.yaml").write_text(text)
    main(["run", "swing", "--scenario", "mine.yaml"])
    assert (runs[0][0].seed, runs[0][0].length_m) == (2, 0.25)


# Runs that fail


@pytest.fixture
def fails_with(pendula, work, monkeypatch):
    """Makes the run write half of its recording and fail."""

    def arrange(error):
        def run(experiment, scenario, runner):
            with atomic_output(runner.options.html) as temporary:
                temporary.write_text("half")
                raise error

        monkeypatch.setattr(pendula, "run", run)

    return arrange


_FILES = ["run", "swing", "--html", "x.html", "--json", "x.json"]


def test_an_error_of_parapod_within_the_run_is_one_line_and_leaves_nothing(
    fails_with, capsys, work
):
    fails_with(ParapodError("leg 2 is stuck"))
    assert main(_FILES) == 2
    assert capsys.readouterr() == ("", "parapod: error: leg 2 is stuck\n")
    assert list(work.iterdir()) == []


def test_control_c_is_exit_code_130_without_a_traceback_and_leaves_nothing(
    fails_with, capsys, work
):
    fails_with(KeyboardInterrupt())
    assert main(_FILES) == 130
    assert capsys.readouterr() == ("", "parapod: interrupted\n")
    assert list(work.iterdir()) == []


def test_a_bug_keeps_its_traceback_and_leaves_nothing(fails_with, work):
    fails_with(ZeroDivisionError())
    with pytest.raises(ZeroDivisionError):
        main(_FILES)
    assert list(work.iterdir()) == []


def test_the_table_is_printed_even_if_the_json_cannot_be_written(
    pendula, work, monkeypatch, capsys
):
    measure = pendula.measure

    def blocked(*arguments):
        (work / "x.json").mkdir()
        return measure(*arguments)

    monkeypatch.setattr(pendula, "measure", blocked)
    assert main(["run", "swing", "--json", "x.json"]) == 2
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


@pytest.mark.parametrize("command", [None, *COMMANDS])
def test_help_fits_80_columns_and_its_examples_are_understood(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([*filter(None, [command]), "--help"])
    assert stop.value.code == 0
    shown = capsys.readouterr().out
    prose, examples = shown.split("examples:\n")
    assert max(map(len, prose.splitlines())) <= 80
    lines = [line.strip() for line in examples.split("\n\n")[0].splitlines()]
    if command is not None:
        assert all(f"parapod {command}" in line for line in lines[-1:])
    calls = [call for line in lines for call in re.findall(r"parapod ([^;>]+?)(?:,| >|;|$)", line)]
    assert len(calls) >= len(lines)
    for call in calls:
        arguments = make_parser().parse_args(shlex.split(call))
        assert arguments.command in COMMANDS


def test_without_a_command_the_help_is_shown(capsys):
    assert main([]) == 0
    assert "parapod run level --meshcat" in capsys.readouterr().out


# compare


def test_compare_shows_what_changed_and_why(runs, capsys, work):
    main(["run", "swing", "--json", "a.json"])
    main(["run", "swing", "--json", "b.json", "--set", "length_m=0.5"])
    capsys.readouterr()
    assert main(["compare", "a.json", "b.json"]) == 0
    out = capsys.readouterr().out
    assert "+41.4 %" in out  # the period grows with the square root of the length
    assert "length_m: 0.25 -> 0.5" in out
    assert "seed" not in out


def test_compare_of_a_result_with_itself_finds_nothing(runs, capsys, work):
    main(["run", "swing", "--json", "a.json"])
    capsys.readouterr()
    assert main(["compare", "a.json", "a.json"]) == 0
    out = capsys.readouterr().out
    assert "the same experiment, backend, seed, version and scenario" in out
    assert "%" not in out


def test_compare_fails_where_a_bound_broke_and_not_where_it_was_mended(runs, capsys, work):
    main(["run", "swing", "--json", "good.json"])
    main(["run", "swing", "--json", "bad.json", "--set", "length_m=4"])
    assert main(["compare", "good.json", "bad.json"]) == 1
    assert "held in A, broken in B: period_s" in capsys.readouterr().out
    assert main(["compare", "bad.json", "good.json"]) == 0


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "'x.json' is not JSON; allowed: what `run --json` wrote"),
        ("[]", "'x.json' is not the result of one run; allowed: what `run --json` wrote"),
        ('{"bounds": {"a": {}}}', "'x.json' is not the result of one run; allowed: .*"),
    ],
)
def test_compare_refuses_other_files(content, message, capsys, work):
    (work / "x.json").write_text(content)
    assert main(["compare", "x.json", "x.json"]) == 2
    assert re.fullmatch(f"parapod: error: {message}\n", capsys.readouterr().err)


def test_the_help_lists_every_command_once_in_its_group(capsys):
    main([])
    shown = capsys.readouterr().out
    places = [shown.index(f"\n{title}:\n") for title in GROUPS]
    assert places == sorted(places)
    for name, command in COMMANDS.items():
        assert len(re.findall(rf"^  {name} +{re.escape(command.HELP)}$", shown, re.M)) == 1


def test_a_former_name_is_accepted_and_the_present_one_named(capsys):
    with pytest.warns(FutureWarning, match="'center-walk' is now called 'centre-walk'"):
        assert main(["scenario", "center-walk"]) == 0
    with pytest.warns(FutureWarning, match="'machining_center' is now called"):
        assert find_machine("machining_center") is find_machine("machining_centre")
    done = subprocess.run(
        [sys.executable, "-m", "parapod.sims", "scenario", "center-walk"],
        capture_output=True,
        text=True,
    )
    assert done.stderr == "parapod: warning: 'center-walk' is now called 'centre-walk'\n"
