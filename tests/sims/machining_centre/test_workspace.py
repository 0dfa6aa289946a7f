import pytest


def test_a_quick_run_holds_its_bounds_and_has_both_tables(finished):
    run = finished("centre-workspace")
    assert run.result.broken == ()
    assert run.values["tripod_reachable_percent"] == pytest.approx(18.6, abs=0.3)
    assert run.values["quadruped_ratio_mean"] == pytest.approx(9.56, rel=0.01)
    tables = run.result.details["table_1"]
    assert tables["tripod"]["printed_percent"] == [16.31, 13.60, 9.49, 3.18]
    assert tables["quadruped"]["nodes_percent"][0] == pytest.approx(16.04, abs=0.05)


def test_the_impossible_means_are_said_with_their_bounds(finished):
    quadruped, tripod = finished("centre-workspace").result.notes
    assert "0.857" in quadruped
    assert "at least 0.94" in quadruped
    assert "1.116" in tripod
    assert "anywhere is 0.98" in tripod


def test_a_box_elsewhere_is_compared_with_nothing(execute):
    result = execute("centre-workspace", "cell_mm=50", "height_mm=750")
    keys = {metric.key for metric in result.metrics}
    assert "nodes_error" not in keys
    values = {metric.key: metric.value for metric in result.metrics}
    assert values["tripod_reachable_percent"] == pytest.approx(3.2, abs=0.5)


def test_a_box_out_of_reach_is_empty(execute):
    result = execute("centre-workspace", "cell_mm=100", "height_mm=1000")
    values = {metric.key: metric.value for metric in result.metrics}
    assert values["tripod_reachable_percent"] == 0.0
    assert "No point of the box can be reached." in result.notes
