"""The report: runs, page and command."""

import base64
import re
from dataclasses import dataclass, replace
from html.parser import HTMLParser

import numpy as np
import pytest
from rich.console import Console

from parapod.sims.cli.main import main
from parapod.sims.lab.experiment import Entry, Experiment
from parapod.sims.lab.figures import Figure
from parapod.sims.lab.results import Metric, Result
from parapod.sims.report import chapters
from parapod.sims.report.chapter import (
    Chapter,
    Check,
    Claim,
    Component,
    Erratum,
    Part,
    Picture,
    Relation,
)
from parapod.sims.report.page import counts, make_page
from parapod.sims.report.run import run_chapter
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.schema import choice, quantity

QUIET = Console(quiet=True)


@dataclass
class TiltScenario:
    """A number that is measured, and a seed that moves it."""

    backend: str = choice("kinematic", ("kinematic",))
    seed: int = quantity(0, 0, 100)
    tilt_deg: float = quantity(0.5, -10.0, 10.0)


def tilt(scenario, options):
    if scenario.tilt_deg == 9.0:
        raise ParapodError("leg 2 is too short by 3 mm")
    value = scenario.tilt_deg + 0.1 * scenario.seed
    figure = Figure("tilt", "Tilt", "A <line>.", lambda canvas: canvas.subplots().plot([0, 1]))
    metric = Metric("tilt_deg", value, "deg", 1.0, meaning="of K_v & friends")
    return Result("tilt", "kinematic", scenario.seed, (metric,), ("a note",), (figure,))


@pytest.fixture
def entries(tmp_path):
    (tmp_path / "tilt.yaml").write_text("tilt_deg: 0.5\n")
    experiment = Experiment("tilt", "Tilts.", TiltScenario, ("kinematic",), tilt)
    return (Entry("tilt", "Tilts.", lambda: experiment, tmp_path),)


def picture():
    return (Picture("The machine", "As it is.", np.full((4, 6, 3), 200, dtype=np.uint8)),)


CHAPTER = Chapter(
    title="A tilting thing",
    paper="Someone, Somewhere 1 (2020) 1",
    summary="It tilts.",
    parts=(Part("tilt", "Tilting", "Read `tilt`.", "tilt", quick=("tilt_deg=0.25",)),),
    claims=(
        Claim("Fig. 1", "K_v <0", 2.0, "deg", lambda n: n("tilt", "tilt_deg"), Relation.AT_MOST),
        Claim("Fig. 2", "mass", 50.0, "kg", lambda _: 50.0, Relation.USED),
        Claim("Fig. 3", "colour", "red", relation=Relation.MISSING),
    ),
    errata=(Erratum("E1", "Eq. (1)", "x", "y", lambda _: Check("1 is not 2", True)),),
    components=(Component("a motor", "Motor"),),
    drawings=(Figure("d", "D", "A drawing.", lambda canvas: None),),
    pictures=picture,
    missing=("The photograph.",),
)


class Tags(HTMLParser):
    """Open tags at the end, and everything that a page would fetch."""

    def __init__(self, text):
        super().__init__()
        self.open, self.fetched, self.ids, self.targets = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag not in ("meta", "img", "br", "link"):
            self.open.append(tag)
        self.ids += [values["id"]] if "id" in values else []
        if tag == "a":
            self.targets.append(values["href"].removeprefix("#"))
        self.fetched += [values[k] for k in ("src",) if k in values]
        self.fetched += [values["href"]] if tag == "link" else []

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def page(entries, chapter=CHAPTER, quick=False, seeds=0):
    run = run_chapter(chapter, entries, quick, seeds, QUIET)
    return run, make_page([run], quick, "2020-02-02")


def test_the_page_is_well_formed_and_needs_nothing_else(entries):
    _, text = page(entries)
    tags = Tags(text)
    assert tags.open == []
    assert len(tags.fetched) == 3
    assert all(source.startswith("data:image/") for source in tags.fetched)
    assert set(tags.targets) <= set(tags.ids)
    assert len(tags.ids) == len(set(tags.ids))
    assert "http" not in re.sub(r"data:[^\"]*", "", text)


def test_the_page_says_what_was_printed_what_came_out_and_the_verdict(entries):
    _, text = page(entries)
    assert '<td data-is="printed" class="number">2 deg</td>' in text
    assert '<td data-is="here" class="number">0.5 deg</td>' in text
    assert "4 times better" in text
    assert "K<sub>v</sub> &lt;0" in text
    assert "not reproduced" in text
    assert "The photograph." in text
    assert "1 is not 2" in text
    assert "Read <code>tilt</code>." in text
    assert "A &lt;line&gt;." in text


def test_pictures_and_figures_are_in_the_page(entries):
    _, text = page(entries)
    png, *svgs = (base64.b64decode(source.split(",", 1)[1]) for source in Tags(text).fetched)
    assert png.startswith(b"\x89PNG")
    assert all(b"<svg" in svg for svg in svgs)


def test_numbers_are_counted_good_ones_first(entries):
    run, _ = page(entries)
    assert list(counts(run).items()) == [("better", 1), ("used", 1), ("not reproduced", 1)]


def test_a_quick_report_takes_the_parts_quick_overrides_and_no_seeds(entries):
    run, text = page(entries, quick=True, seeds=5)
    assert run.numbers("tilt", "tilt_deg") == 0.25
    assert run.parts[0].seeds == ()
    assert "quick report" in text


def test_a_broken_bound_or_an_erratum_that_is_not_borne_out_fails_the_report(entries):
    assert page(entries)[0].passed
    steep = replace(CHAPTER.parts[0], overrides=("tilt_deg=2",))
    run, text = page(entries, replace(CHAPTER, parts=(steep,)))
    assert not run.passed
    assert "BROKEN" in text
    wrong = replace(CHAPTER.errata[0], check=lambda _: Check("it is", False))
    run, text = page(entries, replace(CHAPTER, errata=(wrong,)))
    assert not run.passed
    assert "NOT shown" in text


def test_an_experiment_that_cannot_be_run_is_named_and_the_others_go_on(entries):
    parts = (replace(CHAPTER.parts[0], name="other", overrides=("tilt_deg=9",)), *CHAPTER.parts)
    run, text = page(entries, replace(CHAPTER, parts=parts))
    assert not run.passed
    assert "leg 2 is too short by 3 mm" in text
    assert run.numbers("tilt", "tilt_deg") == 0.5


def test_what_an_earlier_part_shows_is_not_shown_again(entries):
    again = replace(CHAPTER.parts[0], name="again", adds_to="tilt")
    _, text = page(entries, replace(CHAPTER, parts=(*CHAPTER.parts, again)))
    assert text.count("a note") == 1
    assert text.count("A &lt;line&gt;.") == 1


def test_without_a_renderer_the_page_says_why_there_is_no_picture(entries):
    def none():
        raise RuntimeError("no OpenGL")

    run, text = page(entries, replace(CHAPTER, pictures=none))
    assert run.passed
    assert "no picture: no OpenGL" in text


@pytest.fixture
def only_this_chapter(monkeypatch):
    monkeypatch.setattr(chapters, "chapters", lambda: (CHAPTER,))


def test_the_command_writes_the_file_and_sums_up(entries, only_this_chapter, tmp_path, capsys):
    out = tmp_path / "report.html"
    assert main(["report", "--quick", "--out", str(out)], entries) == 0
    assert out.read_text().startswith("<!doctype html>")
    printed = capsys.readouterr().out
    assert "of 3 printed numbers 1 better, 1 used, 1 not reproduced" in printed
    assert f"wrote {out}" in printed


def test_the_command_ends_with_one_if_a_bound_is_broken(
    entries, only_this_chapter, tmp_path, monkeypatch, capsys
):
    steep = replace(CHAPTER.parts[0], quick=("tilt_deg=2",))
    monkeypatch.setattr(chapters, "chapters", lambda: (replace(CHAPTER, parts=(steep,)),))
    out = tmp_path / "report.html"
    assert main(["report", "--quick", "--out", str(out)], entries) == 1
    assert "tilt, seed 0: broken: tilt_deg = 2 deg (bound 1 deg)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "nowhere/report.html"], "the folder 'nowhere' does not exist"),
        (["--seeds", "0"], "must be a whole number of 1 or more, not '0'"),
        (["--slow"], "unrecognized arguments: --slow"),
    ],
)
def test_mistakes_are_refused_in_one_line_before_anything_runs(
    entries, arguments, message, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert main(["report", *arguments], entries) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not list(tmp_path.glob("*.html"))
