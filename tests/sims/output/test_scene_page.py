"""Pages of Meshcat that stand alone: title, origin, player, and nothing that is for a server."""

import re

import pytest
from pydrake.geometry import Meshcat

from parapod.sims.output.moment import moment
from parapod.sims.output.scene_page import bare_page, scene_page, write_page

# A Monday in March, 14:05 in Greenwich.
MADE = 1773065100.0


@pytest.fixture(scope="module")
def static():
    """Meshcat's own page."""
    return Meshcat().StaticHtml()


def test_moments_are_dates_in_universal_time_whatever_the_time_zone(monkeypatch):
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    assert moment(MADE) == "2026-03-09 14:05:00 UTC"
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC", moment())


def test_messages_and_controls_of_meshcat_are_hidden_before_anything_is_drawn(static):
    page = bare_page(static)
    head, _, body = page.partition("<body>")
    (style,) = re.findall("<style>(.*?)</style>", head)
    (hidden,) = re.findall(r"([^{}]*) \{ display: none !important; \}", style)
    assert hidden.split() == [".dg.main,", "#status-message,", "#stats-plot"]
    # They are what Meshcat calls so.
    for name in ('id="status-message"', 'stats.dom.id = "stats-plot"', ".dg.main"):
        assert name in body
    assert len(page) == len(static) + len(f"<style>{style}</style>")


def test_a_page_is_written_with_its_title_its_origin_and_its_time(static, tmp_path):
    path = tmp_path / "a.html"
    write_page(path, static, "level: a <machine>", ["backend kinematic", "seed 3"], MADE)
    text = path.read_text()
    assert re.findall("<title>(.*?)</title>", text) == ["level: a &lt;machine&gt; - parapod"]
    assert "<h1>level: a &lt;machine&gt;</h1>" in text
    (origin,) = re.findall("<p>(.*?)</p>", text)
    backend, seed, made_by, made = origin.split(" · ")
    assert (backend, seed, made) == ("backend kinematic", "seed 3", moment(MADE))
    assert made_by.startswith("parapod ")


def test_the_player_stands_after_the_scene_which_it_leads(static):
    page = scene_page(static)
    assert page.index("var viewer = new MeshCat.Viewer") < page.index('<div id="player" hidden>')
    assert page.rstrip().endswith("</html>")
    assert "<h1>" not in page
    for used in ("actions", "duration", "pause()", "seek("):
        assert f"animator.{used}" in page
    for defined in ("pause(){", "seek(", "this.actions=[]", "this.duration="):
        assert defined in static
