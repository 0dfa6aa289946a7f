"""Runs of a study that are simulated together."""

import itertools

import pytest

import parapod
from parapod.diagrams.side_by_side import LoopRows
from parapod.sims.output.together import Granted, Together, Wish
from parapod.sims.study.runs import carry_out_runs
from parapod.sims.study.study import Study

BRIEF = ("backend=kinematic", "job.estimate_at=0.5", "job.end=1.5", "job.settled_after=0.5",
         "job.waypoints=[]", "job.arm={start: 0.5, duration: 0.5}")  # fmt: skip


def outcomes(vary, rows):
    study = Study.make("level", parapod.scenario("level", *BRIEF), vary)
    pieces = [(run, study.sampling.values(run)) for run in range(study.sampling.runs)]
    return carry_out_runs(study.order, rows, pieces)


@pytest.mark.parametrize("rows", [9, None])
def test_runs_together_are_the_runs_alone(rows):
    # 8 deg cannot be levelled; runs of each height have a loop of their own, alike.
    vary = {"ground.pitch_deg": "-1,8,2", "seed": "0:5", "job.height_mm": "476,478"}
    assert outcomes(vary, rows) == (alone := outcomes(vary, 1))
    assert [bool(outcome.error) for outcome in alone].count(True) == 10
    assert "would need an extension" in next(o.error for o in alone if o.error)


def test_bodies_together_are_the_bodies_alone():
    """By MuJoCo, each with errors in its legs."""
    pytest.importorskip("mujoco")
    bodies = ("backend=mujoco", "plant.leg_model=reduced", "plant.time_step=0.005",
              "plant.length_error_mm=0.3")  # fmt: skip
    study = Study.make("level", parapod.scenario("level", *BRIEF[1:], *bodies), {"seed": "0:9"})
    pieces = [(run, study.sampling.values(run)) for run in range(study.sampling.runs)]
    together, alone = (carry_out_runs(study.order, rows, pieces) for rows in (9, 1))
    assert together == alone
    assert not any(outcome.error for outcome in alone)


@pytest.mark.parametrize("slow", [False, True])
def test_rows_that_are_slower_than_drake_are_given_up(slow, monkeypatch):
    """Nothing but the time differs, and others of the kind begin alone."""
    times, simulated = itertools.cycle([1000.0, 1.0] if slow else [1.0, 1.0]), []

    def timed(work):
        work()
        return next(times)

    def made(loops, scenarios):
        simulated.append(len(scenarios))
        return LoopRows(loops, scenarios)

    monkeypatch.setattr("parapod.sims.output.together._cpu_time", timed)
    monkeypatch.setattr("parapod.sims.output.together.LoopRows", made)
    vary = {"seed": "0:16"}
    assert outcomes(vary, 8) == outcomes(vary, 1)
    assert simulated == ([8] if slow else [8, 8])


class Loop:
    """A loop for which nothing is simulated."""

    def __init__(self, form):
        self.form = form


LOOPS = {form: Loop(form) for form in ("a", "even", "odd", "last")}


def fake(simulated):
    """Takes the place of simulations: a run gets its own number and that of all."""

    def grant(wishes):
        simulated.append([wish.begin for wish in wishes])
        for wish in wishes:
            yield (
                ValueError("failed") if wish.begin < 0 else Granted(wish.begin, len(wishes), None)
            )

    return grant


def run(together, number, forms=("a",)):
    """A run that simulates once for each form of a loop."""

    def work():
        granted = [together.simulate(Wish(LOOPS[form], number, 1.0)) for form in forms]
        return number, [(g.recording, g.elapsed) for g in granted]

    return work


@pytest.fixture
def simulated(monkeypatch):
    runs = []
    monkeypatch.setattr("parapod.sims.output.together._simulated", fake(runs))
    monkeypatch.setattr("parapod.sims.output.together.bytes_of_row", lambda loop, duration: 2**26)
    return runs


def test_results_come_in_the_order_of_the_works_and_forms_apart(simulated):
    together = Together()
    works = [run(together, i, ("even", "last") if i % 2 == 0 else ("odd",)) for i in range(5)]
    assert list(together.carry_out(works)) == [
        (i, [(i, 3), (i, 3)] if i % 2 == 0 else [(i, 2)]) for i in range(5)
    ]
    assert simulated == [[0, 2, 4], [1, 3], [0, 2, 4]]


def test_no_more_rows_than_asked_for_or_than_fit_the_memory(simulated):
    together = Together(2)
    list(together.carry_out(run(together, i) for i in range(5)))
    assert simulated == [[0, 1], [2, 3], [4]]
    simulated.clear()
    together = Together()
    list(together.carry_out(run(together, i) for i in range(13)))
    assert simulated == [list(range(10)), [10, 11, 12]]  # 10 times 64 MiB


def test_a_run_that_simulates_nothing_holds_up_none(simulated):
    together = Together()
    works = [lambda: "nothing", run(together, 1), run(together, 2)]
    assert list(together.carry_out(works)) == ["nothing", (1, [(1, 2)]), (2, [(2, 2)])]


def test_a_row_that_fails_raises_in_its_own_run(simulated):
    together = Together()

    def careful():
        try:
            return run(together, -1)()
        except ValueError as error:
            return str(error)

    assert list(together.carry_out([run(together, 1), careful])) == [(1, [(1, 2)]), "failed"]
    with pytest.raises(ValueError, match="failed"):
        list(together.carry_out([run(together, -1)]))


def test_outside_a_gathering_a_run_is_to_simulate_alone():
    assert Together().simulate(Wish(LOOPS["a"], 1, 1.0)) is None
