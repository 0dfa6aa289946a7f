"""The table of `python -m benchmarks faults`: its verdicts, and that no cell loses it."""

import importlib.util
import io
import json
import sys
from pathlib import Path

import pytest
from rich.console import Console

ROOT = Path(__file__).parents[1]


@pytest.fixture
def matrix(monkeypatch):
    """Module of the table."""
    monkeypatch.syspath_prepend(str(ROOT))
    spec = importlib.util.spec_from_file_location("matrix", ROOT / "benchmarks" / "matrix.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "matrix", module)
    spec.loader.exec_module(module)
    yield module
    for name in [name for name in sys.modules if name.partition(".")[0] == "benchmarks"]:
        del sys.modules[name]


@pytest.mark.parametrize(
    ("values", "verdict"),
    [
        ({"after": 0.5, "bound": 1.0, "code": 2, "is_live": False}, "ok"),
        ({"after": 1.5, "bound": 1.0, "code": 2, "is_live": False}, "late"),
        ({"after": None, "bound": 1.0, "code": 0, "is_live": False}, "exit code 0, not found"),
        ({"after": 0.5, "bound": 1.0, "code": 2, "is_live": True}, "live"),
        ({"code": 0, "is_live": False, "remark": "nothing depends on it"}, "harmless"),
        ({"code": 0, "is_live": True, "remark": "nothing depends on it"}, "live"),
        ({"remark": "no permission", "is_skipped": True}, "skipped"),
        ({"after": 0.1, "bound": 1.0, "code": -9, "is_live": False, "is_broken": True}, "broken"),
    ],
)
def test_a_row_is_judged_by_its_bounds(matrix, values, verdict):
    row = matrix.Row("platform, level", "imu off", **values)
    assert row.verdict == verdict
    assert row.passed == (verdict in ("ok", "harmless", "skipped"))


def test_a_cell_that_goes_wrong_is_a_row_and_the_file_is_whole_after_each(matrix, tmp_path):
    path, stream = tmp_path / "rows.json", io.StringIO()
    table = matrix.Matrix(Console(file=stream, width=120), path, lambda: 0.2)

    def fails():
        assert len(json.loads(path.read_text())["rows"]) == 1
        raise RuntimeError("the job does not begin:\nno [card]")

    good = matrix.Row("chair, walk", "legs off", "legs_stale", 0.1, 1.0, 2, False)
    assert table.measure("chair, walk", "legs off", lambda: good)
    assert not table.measure("chair, walk", "legs slow", fails)
    assert table.measure("chair, walk", "legs stuck", lambda: good)
    written = json.loads(path.read_text())
    assert [row["verdict"] for row in written["rows"]] == ["ok", "broken", "ok"]
    assert written["passed"] is False
    table.print()
    text = stream.getvalue()
    assert "RuntimeError: the job does not begin: no [card]" in " ".join(text.split())
    (missed, live) = table.measurements()
    assert (missed.value, missed.passed, live.value) == (1, False, 0)
    assert "legs slow (broken)" in missed.name


@pytest.mark.parametrize(
    ("load", "is_live", "afters", "verdict"),
    [
        (3.0, False, [5.0, 0.5], "ok"),
        (3.0, False, [5.0, 5.0, 5.0], "late"),
        (0.5, False, [5.0], "late"),  # nobody else is to blame
        (3.0, True, [0.5], "live"),  # nothing excuses that
    ],
)
def test_what_a_busy_computer_has_missed_is_measured_again(matrix, load, is_live, afters, verdict):
    left = list(afters)
    table = matrix.Matrix(Console(file=io.StringIO()), None, lambda: load)
    table.measure(
        *("platform, level", "imu off"),
        lambda: matrix.Row("platform, level", "imu off", "off", left.pop(0), 1.0, 2, is_live),
    )
    (row,) = table.rows
    assert (row.verdict, left) == (verdict, [])
    assert (f"measured {len(afters)} times" in row.remark) == (load > 1.0)
