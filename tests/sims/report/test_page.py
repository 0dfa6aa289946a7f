"""The report: runs, page and command."""

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from rich.console import Console

from parapod.sims.cli.main import main
from parapod.sims.output.figures import Figure
from parapod.sims.report import run as report
from parapod.sims.report.chapter import (
    Chapter,
    Check,
    Claim,
    Component,
    Erratum,
    FutureWork,
    Part,
    Picture,
    Relation,
)
from parapod.sims.report.page import counts, make_page
from parapod.sims.report.run import run_chapter

QUIET = Console(quiet=True)


def picture():
    return (Picture("The machine", "As it is.", np.full((4, 6, 3), 200, dtype=np.uint8)),)


CHAPTER = Chapter(
    title="A swinging thing",
    paper="Someone, Somewhere 1 (2020) 1",
    summary="It swings.",
    parts=(Part("swing", "Swinging", "Read `swing`.", "swing", quick=("length_m=0.5",)),),
    claims=(
        Claim("Fig. 1", "K_v <0", 4.0, "s", lambda n: n("swing", "period_s"), Relation.AT_MOST),
        Claim("Fig. 2", "mass", 50.0, "kg", lambda _: 50.0, Relation.USED),
        Claim("Fig. 3", "colour", "red", relation=Relation.MISSING),
    ),
    errata=(Erratum("E1", "Eq. (1)", "x", "y", lambda _: Check("1 is not 2", True)),),
    components=(Component("a motor", "Motor"),),
    components_in="Table 9",
    drawings=(Figure("d", "D", "A drawing.", lambda canvas: None),),
    pictures=picture,
    missing=("The photograph.",),
    future=(FutureWork("section 9", "a second swing", "It swings twice.", ("swing",)),),
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


@pytest.fixture
def page(pendula, monkeypatch):
    """page(chapter, quick, seeds): what was run, and the page."""
    draw = pendula.draw

    def draw_and_say(*arguments):
        for figure in draw(*arguments):
            yield replace(figure, caption="A <line>.")

    monkeypatch.setattr(pendula, "draw", draw_and_say)
    monkeypatch.setattr(pendula, "note", lambda *arguments: ("a note",))

    def make(chapter=CHAPTER, quick=False, seeds=0):
        run = run_chapter(chapter, quick, seeds, QUIET)
        return run, make_page([run], quick, "2020-02-02")

    return make


def test_what_the_paper_left_to_future_work_is_told_with_what_shows_it(page):
    _, text = page()
    assert "What the paper left to future work" in text
    assert re.search(r"section 9</td>.*a second swing.*It swings twice.*<code>swing</code>", text)


def test_the_page_is_well_formed_and_needs_nothing_else(page):
    _, text = page()
    tags = Tags(text)
    assert tags.open == []
    assert len(tags.fetched) == 3
    assert all(source.startswith("data:image/") for source in tags.fetched)
    assert set(tags.targets) <= set(tags.ids)
    assert len(tags.ids) == len(set(tags.ids))
    assert "http" not in re.sub(r"data:[^\"]*", "", text)


def test_the_page_says_what_was_printed_what_came_out_and_the_verdict(page):
    _, text = page()
    assert '<td data-is="printed" class="number">4 s</td>' in text
    assert '<td data-is="here" class="number">1 s</td>' in text
    assert "4 times better" in text
    assert "K<sub>v</sub> &lt;0" in text
    assert "not reproduced" in text
    assert "The photograph." in text
    assert "1 is not 2" in text
    assert "Read <code>swing</code>." in text
    assert "A &lt;line&gt;." in text


def test_the_contents_list_all_chapters_with_their_sections_first(page):
    run, _ = page()
    other = replace(run, chapter=replace(CHAPTER, title="Another thing"))
    text = make_page([run, other], True, "2020-02-02")
    assert set(Tags(text).targets) <= set(Tags(text).ids)
    above, *chapters = text.split("<section>")
    assert len(chapters) == 2
    sections = []
    for at, title in ((1, CHAPTER.title), (2, "Another thing")):
        links = [f"machine-{at}", f"swing-{at}", f"numbers-{at}", f"missing-{at}", f"errata-{at}"]
        sections += [f"chapter-{at}", *links]
        assert re.search(rf'<a href="#chapter-{at}">{title}</a>', above)
        # A chapter's own contents stay.
        assert (
            Tags(f"<section>{chapters[at - 1].split('</section>')[0]}</section>").targets == links
        )
    assert Tags(above.split("<header>")[1].split("</header>")[0]).targets == sections


def test_the_machine_comes_first_and_the_papers_apparatus_is_folded_away_and_counted(page):
    _, text = page()
    above, apparatus = text.split('<details class="paper" id="paper-1">')  # closed
    assert above.index('id="machine-1"') < above.index('id="swing-1"')
    assert apparatus.startswith(
        "\n<summary>Beside the paper <small>(3 printed numbers, 1 erratum)</small></summary>"
    )
    assert all(f'id="{part}-1"' in apparatus for part in ("numbers", "missing", "errata"))
    folded = re.findall(r"<details>(.*?)</details>", apparatus, re.DOTALL)
    assert text.count("<details") == len(folded) + 1 == 3  # closed, each of them
    used, components = folded
    assert re.search(r"<summary>What is put in <small>\(1 numbers?, 1 of them as ", used)
    assert '<td data-is="printed" class="number">50 kg</td>' in used
    assert re.search(r"<summary>Components <small>\(1 of the paper's, ", components)
    assert "<th>component in the paper (Table 9)</th>" in components
    assert "<code>Motor</code>" in components
    assert "4 times better" not in used


def test_the_papers_apparatus_is_open_where_an_erratum_is_not_shown(page):
    wrong = replace(CHAPTER.errata[0], check=lambda _: Check("it is", False))
    assert 'id="paper-1" open>' in page(replace(CHAPTER, errata=(wrong,)))[1]


def test_a_part_names_its_source_in_the_paper(page):
    sourced = replace(CHAPTER.parts[0], source="Eq. 7")
    assert (
        "Swinging <small>Eq. 7 of the paper</small></h3>"
        in (page(replace(CHAPTER, parts=(sourced,)))[1])
    )
    assert "Swinging</h3>" in page()[1]


def test_what_is_folded_away_is_printed(page):
    _, text = page()
    (printed,) = re.findall(r"@media print \{(.*?)\n\}", text, re.DOTALL)
    assert "details::details-content { content-visibility: visible; " in printed
    (script,) = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    assert re.search(r'"beforeprint".*details:not\(\[open\]\).*open = .*true', script, re.DOTALL)
    assert re.search(r'"afterprint".*open = false', script, re.DOTALL)


def test_a_number_that_the_paper_measured_is_said_to_be_simulated_here(page):
    measured = replace(CHAPTER.claims[0], is_measured=True)
    for claim, count in ((CHAPTER.claims[0], 0), (measured, 1)):
        run, text = page(replace(CHAPTER, claims=(claim,)))
        assert counts(run) == {"better": 1}
        assert text.count("simulated here") == count


def test_pictures_and_figures_are_in_the_page(page):
    _, text = page()
    png, *svgs = (base64.b64decode(source.split(",", 1)[1]) for source in Tags(text).fetched)
    assert png.startswith(b"\x89PNG")
    assert all(b"<svg" in svg for svg in svgs)
    # In a grid, each as wide as its size on paper asks for.
    grids = re.findall(r'<div class="figures">(.*?)</div>', text, re.DOTALL)
    assert [grid.count('style="--inches: 7.0"') for grid in grids] == [1, 1]


def test_numbers_are_counted_good_ones_first(page):
    run, _ = page()
    assert list(counts(run).items()) == [("better", 1), ("used", 1), ("not reproduced", 1)]


def test_a_quick_report_takes_the_parts_quick_overrides_and_no_seeds(page):
    run, text = page(quick=True, seeds=5)
    assert run.numbers("swing", "period_s") == pytest.approx(1.4185, rel=1e-4)
    assert run.parts[0].seeds == ()
    assert "quick report" in text
    assert "<code>parapod run swing --set length_m=0.5</code>" in text
    assert "<code>parapod run swing</code>" in page()[1]


def test_a_quick_report_does_not_say_more_than_it_did(page):
    brief = replace(CHAPTER.parts[0], text="All of it.", quick_text="A part of it.")
    for quick, said, unsaid in ((True, "A part of it.", "All of it."), (False, "All", "A part")):
        _, text = page(replace(CHAPTER, parts=(brief,)), quick=quick)
        assert said in text
        assert unsaid not in text


def test_a_broken_bound_or_an_erratum_that_is_not_borne_out_fails_the_report(page):
    assert page()[0].passed
    steep = replace(CHAPTER.parts[0], overrides=("length_m=4",))
    run, text = page(replace(CHAPTER, parts=(steep,)))
    assert not run.passed
    assert "BROKEN" in text
    wrong = replace(CHAPTER.errata[0], check=lambda _: Check("it is", False))
    run, text = page(replace(CHAPTER, errata=(wrong,)))
    assert not run.passed
    assert "NOT shown" in text


def test_an_experiment_that_cannot_be_run_is_named_and_the_others_go_on(page):
    parts = (replace(CHAPTER.parts[0], name="other", overrides=("length_m=90",)), *CHAPTER.parts)
    run, text = page(replace(CHAPTER, parts=parts))
    assert not run.passed
    assert "length_m = 90 is outside 0.1..10" in text
    assert run.numbers("swing", "period_s") == pytest.approx(1.0030, rel=1e-4)


def test_what_an_earlier_part_shows_is_not_shown_again(page):
    again = replace(CHAPTER.parts[0], name="again", adds_to="swing")
    _, text = page(replace(CHAPTER, parts=(*CHAPTER.parts, again)))
    assert text.count("a note") == 1
    assert text.count("A &lt;line&gt;.") == 1


def test_without_a_renderer_the_page_says_why_there_is_no_picture(page):
    def none():
        raise RuntimeError("no OpenGL")

    run, text = page(replace(CHAPTER, pictures=none))
    assert run.passed
    assert "no picture: no OpenGL" in text


def test_seeds_are_run_and_shown_beside_the_first(page):
    run, text = page(seeds=2)
    assert [result.seed for result in run.parts[0].results] == [0, 0, 1]
    assert "1 / 1 / 1" in text


def test_the_command_writes_the_file_and_sums_up(page, monkeypatch, work, capsys):
    monkeypatch.setattr(report, "list_chapters", lambda: (CHAPTER,))
    assert main(["report", "--quick", "--out", "report.html"]) == 0
    assert (work / "report.html").read_text().startswith("<!doctype html>")
    printed = capsys.readouterr().out
    assert re.search(r"of 3 printed numbers 1 \w+, 1 used, 1 not reproduced", printed)
    assert "wrote report.html" in printed


def test_the_command_ends_with_one_if_a_bound_is_broken(page, monkeypatch, work, capsys):
    slow = replace(CHAPTER.parts[0], quick=("length_m=4",))
    monkeypatch.setattr(report, "list_chapters", lambda: (replace(CHAPTER, parts=(slow,)),))
    assert main(["report", "--quick", "--out", "report.html"]) == 1
    printed = capsys.readouterr().out
    assert "swing, seed 0: broken: period_s = 4.0121 s (bound 2.5 s)" in printed
