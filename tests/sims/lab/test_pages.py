"""Pages of single runs."""

import re
import tempfile
import webbrowser
from pathlib import Path
from urllib.parse import unquote, urlparse

from parapod.sims.cli.main import main
from parapod.sims.lab.pages import result_page
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric, Result


def test_a_page_of_a_run_holds_its_figures_metrics_and_notes():
    metrics = (Metric("a_mm", 1.25, "mm", 2.0, meaning="of <a>"), Metric("b", 3.0, bound=2.0))
    figure = Figure("f", "A line", "What it shows.", lambda canvas: canvas.add_subplot(), (3, 2))
    page = result_page(Result("trial", "exact", 7, metrics, ("It is so.",), (figure,)))
    assert "1 of 2</b>bounds held" in page
    assert "seed 7" in page
    assert page.count("<img ") == 1
    assert "<b>A line.</b> What it shows." in page
    assert "of &lt;a&gt;" in page
    assert re.search(r"1\.25 mm.*&lt;= 2.*held.*BROKEN", page, re.DOTALL)
    assert "It is so." in page
    assert not re.search(r'(src|href)="(?!data:)', page)


def test_plot_opens_such_a_page(tmp_path, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert main(["run", "chair-gait", "--plot"]) == 0
    (page,) = (Path(unquote(urlparse(uri).path)) for uri in opened)
    assert f"wrote {page}" in capsys.readouterr().out
    text = page.read_text()
    assert "<h1>chair-gait</h1>" in text
    assert text.count("<img ") >= 1
    assert "seed: 0" in text
