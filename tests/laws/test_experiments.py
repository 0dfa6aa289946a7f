"""Laws of every experiment that is installed: its listing, its refusals, its files."""

import io
import json
import math
import pickle
import re
import subprocess
import sys
import xml.etree.ElementTree
from importlib.metadata import version

import numpy as np
import pytest
from rich.console import Console

from parapod.sims.lab.discovery import find_entry, list_entries
from parapod.sims.output.figures import draw, render
from parapod.sims.output.options import Loops, RunOptions
from parapod.sims.output.results import print_table
from parapod.sims.replay.figure import make_figure
from parapod.sims.replay.replay import open_replays
from parapod.sims.report.run import list_chapters
from parapod.systems.core.errors import OutputError, ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.core.schema import fields_of, is_schema

OWN = [entry for entry in list_entries() if entry.package == "parapod"]
PARTS = [part for chapter in list_chapters() for part in chapter.parts]
DRAWINGS = [drawing for chapter in list_chapters() for drawing in chapter.drawings]
each_entry = pytest.mark.parametrize("entry", list_entries(), ids=lambda entry: entry.name)
each_part = pytest.mark.parametrize("part", [part.name for part in PARTS])
# The options that need a hook, and the hook.
HOOKS = {"meshcat": "scene", "html": "scene", "log": "logged", "graphviz": "loop"}
# As little as passes for a job on the kinematic backend.
JOB = (
    "backend=kinematic",
    "ground.roll_deg=0.3",
    "ground.pitch_deg=0.2",
    "job.initial_extension_mm=405",
    "job.estimate_at=1.5",
    "job.settled_after=1.5",
    "job.waypoints=[]",
    "job.arm={start: 0.5, duration: 0.5}",
    "job.end=2",
)
COARSE = ("plant.leg_model=reduced", "plant.time_step=0.01")
HASTE = ("motion.acceleration_mm_s2=4000",)
# Briefer than quick, for experiments that are run twice; their bounds need not hold.
BRIEF = {
    "level": JOB,
    "uneven-ground": (*JOB, "ground.foot_heights_mm=[1, 0, 0, 2]"),
    "track-posture": (
        *JOB[:5],
        "job.settled_after=0.5",
        "job.waypoints=[{time: 0.5, height_mm: 1}]",
        "job.end=6",
    ),
    "compare-engines": (
        *("plant.time_step=0.005", "steps_ms=[5]", "job.estimate_at=0.5", "job.waypoints=[]"),
        *(
            "job.settled_after=0.5",
            "job.arm={start: 0.1, duration: 0.1, angle_deg: 1}",
            "job.end=1",
        ),
    ),
    "chair-engines": (
        *("plant.time_step=0.005", "steps_ms=[5]", "gait.lift_mm=3", "gait.step_mm=4"),
        *("gait.swing_height_mm=1", "gait.phase_duration=0.5", "begin=0.1", "end=0.1"),
    ),
    "validate-kinematics": (*COARSE, *JOB[3:]),
    "deploy": ("backend=kinematic", "longest=3"),
    "fault-campaign": ("device=encoder", "phase=transport", "window=0.5"),
    "inspect": (
        *("backend=kinematic", "job.estimate_at=1.5", "job.settled_after=1.5"),
        *("inspection.points=[{place_mm: [1030, 20, 2360]}]", "inspection.hold_s=0.1"),
    ),
    "tip-hold": (
        *("backend=kinematic", "job.estimate_at=1.5", "job.settled_after=1.5", "hold.end_s=6"),
        "disturbances=[!Subsidence {at: 4}, !Push {at: 4.5}, !Payload {at: 5, duration: 0.1}]",
    ),
    "arm-vibration": (
        *("backend=kinematic", "job.estimate_at=1.5", "job.settled_after=1.5"),
        *("job.arm={start: 0.5, duration: 0.5}", "job.end=2.5"),
    ),
    "identify-actuators": COARSE,
    "identify-arm": ("backend=kinematic",),
    "mechanism-track": (
        *("backend=kinematic", "track={waypoints: [{time: 0.4, z_mm: 2}], begin: 0.2, end: 0.1}"),
    ),
    "mechanism-load": ("plant.time_step=0.005",),
    "mechanism-workspace": ("cells=6", "asked_percent=100"),
    "push": (
        *("backend=kinematic", "directions=2", "share=1", "first_N=50", "most_N=50", "at=1.5"),
        f"settings={list(JOB[1:])}",
    ),
    "slip": (*COARSE, "lift.duration=0.5", "arm.duration=0.5", "arm.rest=0", "creep.duration=0.1"),
    "workspace": ("resolution=16",),
    "centre-machining": (
        *("backend=kinematic", "holes.count=1", "holes.depth_mm=1", *HASTE),
        *("motion.rapid_mm_s=300", "motion.feed_mm_s=20"),
    ),
    "centre-walk": (
        *("backend=kinematic", "holes.count=0", "walk.steps=1", "walk.advance_mm=20"),
        *("walk.lift_mm=5", "motion.swing_mm_s=200", "control.settling=0.04", *HASTE),
    ),
    "bench-walk": (
        *("gait.strides=1", "gait.run_up=0", "gait.speed_m_s=0.8", "shift=0.1", "end=0.1"),
    ),
    "bench-course": ("courses=[level]", "strides=1", "run_up=0"),
    "bench-leg": ("jump_mm=20", "squat_mm=40", "tries=[jump]"),
    "centre-locks": ("poses=10", "time_step=0.005", "duration=0.4"),
    "chair-walk": (
        *("backend=mock", "gait.way=forward", "gait.lift_mm=6", "gait.step_mm=10"),
        *("gait.swing_height_mm=2", "gait.phase_duration=1", "begin=0.5", "end=0.5"),
    ),
    "chair-circle": ("circle.laps=1", "circle.radius_mm=5", "circle.lap_duration=2"),
    "chair-payload": ("instants=1",),
    "bench-workspace": ("cells=100",),
    "centre-workspace": ("cell_mm=30",),
}


def scenario_of(entry, *overrides):
    return load_scenario(entry.load().schema, entry.default_scenario, None, overrides)


def quiet(**options):
    return RunOptions(console=Console(file=io.StringIO()), **options)


# --- as it is listed


@each_entry
def test_its_summary_is_one_line_that_begins_with_an_imperative(entry):
    assert re.fullmatch(r"[A-Z][a-z]+ [^\n]+\.", entry.summary)
    first = entry.summary.split()[0]
    assert not re.search(r"(s|ed|ing)$", first), f"{first} is no imperative"
    assert first not in ("The", "A", "An", "What", "How", "Of")
    assert len(entry.summary) <= 99


@each_entry
def test_it_is_listed_under_its_machine_with_the_time_that_it_takes(entry):
    assert re.fullmatch(r"[A-Z][\w ]+", entry.group)
    assert re.fullmatch(r"\d+ (s|min|h)", entry.takes)
    (text,) = {
        other.group for other in list_entries() if other.source.parent == entry.source.parent
    }
    assert text == entry.group


@each_entry
def test_what_is_read_of_its_source_is_what_its_class_says(entry):
    experiment = entry.load()
    assert experiment.name == entry.name
    assert experiment.takes == entry.takes
    assert dict(experiment.switches) == dict(entry.switches)


def test_names_differ_and_parapod_s_own_come_first():
    names = [entry.name for entry in list_entries()]
    assert len(names) == len(set(names))
    assert list_entries()[: len(OWN)] == tuple(OWN)


def test_every_experiment_of_parapod_is_in_a_chapter_of_the_report():
    assert {part.experiment for part in PARTS} == {entry.name for entry in OWN}


# --- its scenario


@each_entry
def test_its_scenario_has_a_backend_and_a_seed(entry):
    experiment = entry.load()
    assert is_schema(experiment.schema)
    rules = fields_of(experiment.schema)
    assert isinstance(experiment.schema().seed, int)
    assert set(experiment.backends) <= set(rules["backend"][1].options)
    assert experiment.schema().backend in experiment.backends


@each_entry
def test_its_seed_is_any_number_that_is_not_negative_and_has_31_bits(entry):
    for seed in (0, 2**31 - 1):
        assert scenario_of(entry, f"seed={seed}").seed == seed
    for seed in (-1, 2**31):
        with pytest.raises(ScenarioError, match=rf"seed = {seed} is outside 0..2147483647"):
            scenario_of(entry, f"seed={seed}")


@each_entry
def test_its_default_scenario_and_each_switch_are_admissible(entry):
    experiment = entry.load()
    scenario = scenario_of(entry)
    experiment.check_backend(scenario.backend)
    experiment.check(scenario)
    for override, words in entry.switches.values():
        assert words.strip()
        switched = scenario_of(entry, override)
        assert switched != scenario
        experiment.check(switched)


@each_entry
def test_another_backend_is_refused_with_those_on_which_it_runs(entry):
    experiment = entry.load()
    with pytest.raises(ScenarioError, match=r"backend = 'steam' is not one of "):
        scenario_of(entry, "backend=steam")
    with pytest.raises(ScenarioError) as refused:
        experiment.check_backend("steam")
    known = ", ".join(experiment.backends)
    assert str(refused.value) == (
        f"backend = 'steam' is not one on which '{entry.name}' runs; there are: {known}"
    )
    assert refused.value.key == "backend"


# --- its options


def never(*arguments, **options):
    raise AssertionError("it has run")


@each_entry
@pytest.mark.parametrize("option", HOOKS)
def test_an_option_is_answered_by_its_hook_or_refused_before_anything_runs(
    entry, option, tmp_path, monkeypatch
):
    experiment = entry.load()
    if hasattr(experiment, HOOKS[option]):
        experiment._check_options(RunOptions(**{option: tmp_path / "x"}))
        return
    monkeypatch.setattr(experiment, "run", never)
    path = tmp_path / "x"
    with pytest.raises(OutputError) as refused:
        experiment.execute(
            scenario_of(entry), quiet(**{option: True if option == "meshcat" else path})
        )
    able = [f"--{name}" for name, hook in HOOKS.items() if hasattr(experiment, hook)]
    assert str(refused.value) == (
        f"--{option} has nothing to show of '{entry.name}'; "
        f"there are: {', '.join(['--json', '--figures', *able])}"
    )
    assert not path.exists()


@each_entry
def test_a_log_of_unknown_format_is_refused_before_anything_runs(entry, tmp_path, monkeypatch):
    experiment = entry.load()
    if not hasattr(experiment, "logged"):
        pytest.skip("it has no log")
    monkeypatch.setattr(experiment, "run", never)
    with pytest.raises(OutputError, match=r"must be one of \.npz, \.mcap, \.csv$"):
        experiment.execute(scenario_of(entry), quiet(log=tmp_path / "a.xyz"))


# --- its result


@each_part
def test_a_quick_run_holds_its_bounds_and_is_silent_in_a_file(part, finished):
    run = finished(part)
    assert run.result.broken == ()
    assert any(metric.is_bounded for metric in run.result.metrics)
    assert run.said == ""


@each_part
def test_metrics_have_keys_units_and_bounds_that_fit_together(part, finished):
    metrics = finished(part).result.metrics
    keys = [metric.key for metric in metrics]
    assert len(keys) == len(set(keys))
    suffixes = {"deg": "deg", "mm": "mm", "um": "um", "s": "s", "V": "V", "kg": "kg", "N": "N"}
    suffixes |= {"mg": "mg", "percent": "%", "dB": "dB", "m": "m", "m3": "m^3", "mm_s": "mm/s"}
    suffixes |= {"rad_s": "rad/s", "m_s": "m/s", "m2": "m^2"}
    for metric in metrics:
        assert re.fullmatch(r"[a-z][A-Za-z0-9_]*", metric.key)
        ends = [end for end in suffixes if metric.key.endswith(f"_{end}")]
        if ends:
            assert metric.unit == suffixes[max(ends, key=len)], metric.key
        for limit in (metric.bound, metric.at_least):
            assert limit is None or math.isfinite(limit)
        if metric.bound is not None and metric.at_least is not None:
            assert metric.at_least <= metric.bound


# First words of metrics' meanings: quantities, and adjectives that go before them.
QUANTITIES = re.compile(
    r"((relative )?change|(smallest )?singular value|(simulated )?time|actuator gain|angle|area|"
    r"bias|cells|clearance|condition number|creep|depth|difference|drift|drilled holes|error|"
    r"extent|faults|feet|force|height|increase|kinds|mass|mean|number|pairs|payload|ratio|ripple|"
    r"share|slip|speed|spread|standard deviation|steps|stiffness|volume|way|"
    r"largest|smallest|longest|lowest|widest)\b"
)


@each_part
def test_meanings_of_metrics_stand_alone_in_a_table_of_any_order(part, finished):
    metrics = finished(part).result.metrics
    assert [m.key for m in metrics if not QUANTITIES.match(m.meaning)] == []
    meanings = [metric.meaning for metric in metrics]
    assert len(meanings) == len(set(meanings))
    assert [m.key for m in metrics if not (math.isfinite(m.value) or m.undefined)] == []


@each_part
def test_every_figure_is_drawn_says_what_it_shows_and_has_one_unit_an_axis(
    part, finished, monkeypatch
):
    drawn = []  # each once: the report's figures take a minute
    monkeypatch.setattr(
        "parapod.sims.output.figures.draw",
        lambda *given: drawn.append(draw(*given)) or drawn[-1],
    )
    figures = finished(part).result.figures
    names = [figure.name for figure in figures]
    assert len(names) == len(set(names))
    # What an earlier part shows too has been drawn there.
    (earlier,) = [other.adds_to for other in PARTS if other.name == part]
    shown = {figure.name for figure in finished(earlier).result.figures} if earlier else ()
    for figure in figures:
        if figure.name in shown:
            continue
        assert re.fullmatch(r"[a-z][a-z0-9_]*", figure.name)
        assert figure.title.strip()
        # One that is named by the paper's number says which figure it is.
        for number in re.findall(r"\d+", figure.name) if figure.name.startswith("fig") else ():
            assert re.search(rf"Figs?\..*\b{int(number)}[a-c]?\b", figure.caption), figure.name
        assert re.fullmatch(r"[A-Z].+\.", figure.caption, re.DOTALL)
        root = xml.etree.ElementTree.fromstring(render(figure))
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert check_units(figure, drawn.pop()), figure.name


def check_units(figure, canvas):
    """Proves that each axis says one unit, which no name in a legend changes."""
    texts = []
    for axes in canvas.axes:
        found = [axis.get_label_text() for axis in (axes.xaxis, axes.yaxis)]
        found += [axes.zaxis.get_label_text()] if hasattr(axes, "zaxis") else []
        texts += filter(None, found)
    wrong = [text for text in texts if not re.fullmatch(r"[^\[\]]*\S \[[^\[\],]+\]", text)]
    assert wrong == [], figure.name
    legends = [*canvas.legends, *(axes.get_legend() for axes in canvas.axes)]
    names = [text.get_text() for legend in legends if legend for text in legend.get_texts()]
    assert [name for name in names if "[" in name] == [], figure.name
    return texts


@pytest.mark.parametrize("drawing", DRAWINGS, ids=lambda drawing: drawing.name)
def test_every_axis_of_a_chapter_s_drawings_has_one_unit(drawing):
    check_units(drawing, draw(drawing))


@each_part
def test_its_json_is_strict_and_tells_everything_about_the_run(part, finished, tmp_path):
    run = finished(part)
    text = json.dumps(run.result.as_json(), allow_nan=False)
    data = json.loads(text)
    head = {"experiment": run.experiment.name, "backend": run.scenario.backend}
    head |= {"seed": run.scenario.seed, "passed": True, "parapod": version("parapod")}
    assert head.items() <= data.items()
    assert set(data["bounds"]) == set(run.values)
    for metric in run.result.metrics:
        told = data["bounds"][metric.key]
        assert data[metric.key] == pytest.approx(metric.value)
        assert (told["unit"], told["verdict"]) == (metric.unit, metric.verdict)
        assert told["bound"] == metric.bound
        assert told["at_least"] == metric.at_least
    # JSON is YAML: what was run can be run again.
    again = tmp_path / "again.yaml"
    again.write_text(json.dumps(data["scenario"]))
    assert load_scenario(type(run.scenario), None, again) == run.scenario


@each_part
def test_its_table_and_notes_lose_nothing_at_80_columns(part, finished):
    stream = io.StringIO()
    print_table(finished(part).result, Console(file=stream, width=80))
    text = stream.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    joined = re.sub(r"\s", "", text)
    for note in finished(part).result.notes:
        assert re.sub(r"\s", "", note) in joined


@each_part
def test_its_log_has_a_unit_for_every_signal_and_says_how_it_was_made(part, finished, tmp_path):
    run = finished(part)
    if run.log is None:
        pytest.skip("it has no log")
    units = run.log.metadata["units"]
    assert set(units) == set(run.log.signals)
    assert all(unit.strip() for unit in units.values())
    assert (np.diff(run.log.time) >= 0.0).all()
    for name, samples in run.log.signals.items():
        assert len(samples) == len(run.log.time), name
    assert run.log.metadata["experiment"] == run.experiment.name
    assert run.log.metadata["parapod"] == version("parapod")
    again = tmp_path / "again.yaml"
    again.write_text(run.log.metadata["scenario"])
    assert load_scenario(type(run.scenario), None, again) == run.scenario


@each_part
def test_its_log_is_replayed_with_its_machine(part, finished):
    run = finished(part)
    if run.log is None:
        pytest.skip("it has no log")
    replay, _ = open_replays(run.log_file, None, (), Console(quiet=True))
    subject, digest = replay.subject, replay.digest
    assert replay.plots
    assert all(curve.signal in digest.lines for plot in replay.plots for curve in plot.curves)
    assert all(plot.unit and "," not in plot.unit for plot in replay.plots)
    assert digest.rows == len(run.log.time)
    assert subject.drawn, subject.undrawn
    assert not subject.remarks
    twin = subject.drawn.make()
    for time, row in (digest.pictures[0], digest.pictures[-1]):
        twin.show(subject.drawn.values(row), time)
    assert twin.time == digest.pictures[-1][0]
    names = {name for plot in replay.plots for name in (curve.signal for curve in plot.curves)}
    assert len(names) > 1, "it has usual plots"
    assert make_figure(replay, None).size[1] > 0.0


@each_part
def test_a_run_that_holds_its_bounds_lies_within_the_limits_of_its_signals(part, finished):
    run = finished(part)
    limits = run.experiment.limits(run.scenario)
    signals = {} if run.log is None else run.log.signals
    machine = getattr(run.experiment.drawing or run.experiment, "machine", None)
    declared = (
        machine.for_scenario(run.experiment.machine_scenario(run.scenario)).table
        if machine
        else {}
    )
    holds = all(metric.passed for metric in run.result.metrics if not metric.is_timing)
    for name, (low, high) in limits.items():
        assert name in signals or name in declared, name
        ends = [np.asarray(each, float) for each in (low, high) if each is not None]
        assert all(np.isfinite(each).all() for each in ends)
        assert len(ends) == 1 or (ends[0] < ends[1]).all(), name
        size = declared[name].size if name in declared else 0
        if name in signals:
            size = int(np.prod(signals[name].shape[1:]))
        assert all(each.size in (1, size or each.size) for each in ends), name
        if name in signals and holds:
            values = signals[name].reshape(-1, size)
            # What a drive that is led to its limit overshoots, and one count of an encoder.
            slack = 0.02 * np.max(np.abs(ends)) + 1e-9
            assert low is None or (values >= low - slack).all(), f"{name}: {values.min(axis=0)}"
            assert high is None or (values <= high + slack).all(), f"{name}: {values.max(axis=0)}"


@each_part
def test_its_diagram_is_graphviz_text(part, finished):
    if finished(part).diagram is None:
        pytest.skip("it has no diagram")
    assert finished(part).diagram.startswith("digraph")


# --- run again, elsewhere


# Those that take seconds; that their machines' loops give the same numbers is a law of machines.
LONG = {
    *(
        "arm-workspace",
        "bench-course",
        "bench-leg",
        "bench-walk",
        "centre-machining",
        "centre-walk",
    ),
    *("chair-circle", "chair-engines", "compare-engines", "fault-campaign"),
    *("identify-actuators", "slip", "track-posture"),
}


@pytest.mark.parametrize(
    "entry",
    [pytest.param(entry, marks=[pytest.mark.slow] if entry.name in LONG else []) for entry in OWN],
    ids=lambda entry: entry.name,
)
def test_the_same_scenario_gives_the_same_metrics(entry):
    experiment = pickle.loads(pickle.dumps(entry.load()))
    scenario = scenario_of(entry, *BRIEF.get(entry.name, ()))
    # Once as a study has it run.
    first, again = (experiment.execute(scenario, quiet(loops=loops)) for loops in (None, Loops()))

    def values(result):
        return {m.key: m.value for m in result.metrics if not m.is_timing}

    assert values(first) == pytest.approx(values(again), rel=0.0, abs=0.0, nan_ok=True)
    assert first.notes == again.notes
    assert first.scenario == scenario


def test_watching_a_loop_changes_no_number(tmp_path):
    entry = find_entry("level")
    scenario = scenario_of(entry, *BRIEF["level"])
    watched = quiet(html=tmp_path / "a.html", log=tmp_path / "a.npz")
    plain, shown = (entry.load().execute(scenario, options) for options in (quiet(), watched))
    for one, other in zip(plain.metrics, shown.metrics, strict=True):
        assert one.key == other.key
        assert one.is_timing or one.value == other.value
    page = (tmp_path / "a.html").read_text()
    assert not re.search(r"<script[^>]*\bsrc=|<link[^>]*\bhref=\"(?!data:)", page)
    assert len(page) > 1e6
    title = "level: the levelling platform"
    assert re.findall("<title>(.*?)</title>", page) == [f"{title} - parapod"]
    assert f"<h1>{title}</h1><p>backend {scenario.backend} · seed {scenario.seed} · " in page
    assert re.search(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC</p>", page)


def test_importing_every_experiment_draws_nothing():
    program = (
        "import sys\n"
        "from parapod.sims.lab.discovery import list_entries\n"
        "for entry in list_entries(): entry.load()\n"
        "print(*[name for name in sys.modules if name.startswith('matplotlib')])\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr


def test_an_experiment_of_one_machine_loads_no_other_machine():
    machines = {entry.source.parent.name for entry in OWN}
    for entry in (find_entry("level"), find_entry("chair-walk")):
        program = (
            "import sys\n"
            "from parapod.sims.lab.discovery import find_experiment\n"
            f"find_experiment({entry.name!r}).schema()\n"
            "print(*sys.modules)\n"
        )
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        loaded = {part for name in done.stdout.split() for part in name.split(".")}
        assert loaded & machines == {entry.source.parent.name}
