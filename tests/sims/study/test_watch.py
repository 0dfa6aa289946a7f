"""A study that is looked at while it runs."""

import threading
import urllib.request

import pytest
from rich.console import Console

import parapod.sims.study.watch as watch
from parapod.sims.lab.serve import PageServer
from parapod.sims.study.records import Records
from parapod.sims.study.runs import carry_out_runs
from parapod.sims.study.study import Study
from parapod.systems.core.scenario_file import load_scenario

QUIET = Console(quiet=True)


@pytest.fixture
def servers(monkeypatch):
    """Servers of pages, whose wait for Ctrl-C ends with them."""
    made = []

    class Kept(PageServer):
        def __init__(self, page):
            super().__init__(page)
            made.append(self)

    monkeypatch.setattr(watch, "PageServer", Kept)
    return made


def read(server):
    with urllib.request.urlopen(server.url) as answer:
        return answer.read().decode()


def test_the_page_grows_with_the_runs_and_stays_until_it_is_ended(pendula, servers, monkeypatch):
    scenario = load_scenario(pendula("swing").schema)
    study = Study.make("swing", scenario, {"seed": "0:3", "length_m": "1,2"})
    records, pieces = Records(study.sampling), [(i, study.sampling.values(i)) for i in range(6)]
    with watch.watched(study, records, QUIET) as look:
        (server,) = servers
        assert "0 of 6 runs" in read(server)
        for count, piece in enumerate(pieces, start=1):
            records.add(*carry_out_runs(study.order, 1, [piece]))
            monkeypatch.setattr(watch.time, "monotonic", lambda now=1e9 * count: now)
            look()
            page = read(server)
            assert f"{count} of 6 runs" in page
            assert 'http-equiv="refresh"' in page
            assert "period_s" in page
        monkeypatch.undo()
        end = threading.Timer(0.5, server.shutdown)
        end.start()
    assert "6 runs" in server.page.decode()
    assert 'http-equiv="refresh"' not in server.page.decode()
