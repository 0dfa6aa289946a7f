"""Work for executors: which pieces are carried out again, and when it is given up."""

import time
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ThreadPoolExecutor

import pytest

from parapod.sims.lab.work import Crew, NoWorkers, WorkerDied, carry_out


class Scripted(Executor):
    """Does with each parcel what a script says: "ok", "broken", "pending" or an exception."""

    def __init__(self, script=()):
        self.script, self.sent, self.futures = list(script), [], []

    def submit(self, function, pieces):
        self.sent.append(list(pieces))
        future, what = Future(), self.script.pop(0) if self.script else "ok"
        self.futures.append(future)
        if what == "broken":
            future.set_exception(BrokenExecutor())
        elif what == "ok":
            future.set_result(function(pieces))
        elif what != "pending":
            future.set_exception(what)
        return future


class Renewed(Crew):
    """A crew whose executor is replaced by the next of a list."""

    def __init__(self, size, *scripts):
        self.executors = [Scripted(script) for script in scripts]
        super().__init__(self.executors.pop(0), size)
        self.used = [self.executor]

    def renew(self):
        self.executor = self.executors.pop(0)
        self.used.append(self.executor)


def square(number):
    return number * number


def test_each_piece_is_carried_out_once():
    with ThreadPoolExecutor(3) as pool:
        found = dict(carry_out(Crew(pool, 3), square, range(100)))
    assert found == {i: i * i for i in range(100)}


def test_there_is_no_work_without_pieces():
    crew = Renewed(1, [])
    assert list(carry_out(crew, square, [])) == []
    assert crew.used[0].sent == []


def test_pieces_are_taken_as_they_are_needed():
    taken = []
    pieces = (taken.append(i) or i for i in range(1000))
    crew = Renewed(2, ["pending"] * 4)
    work = carry_out(crew, square, pieces)
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(next, work)
        time.sleep(0.05)
        assert taken == [0, 1, 2, 3]  # one for each worker, and one that it finds then
        crew.executor.futures[2].set_result(([4], 0.001))
        assert first.result() == (2, 4)
    work.close()
    assert [future.cancelled() for future in crew.executor.futures[:4]] == [
        *(True, True, False, True)
    ]


def test_short_pieces_are_sent_in_parcels_and_long_ones_alone():
    crew = Renewed(1, [])
    list(carry_out(crew, square, range(200)))
    sizes = [len(parcel) for parcel in crew.executor.sent]
    assert sizes[0] == 1
    assert max(sizes) == 64
    crew = Renewed(1, [])
    list(carry_out(crew, lambda seconds: time.sleep(seconds), [0.3] * 3))
    assert [len(parcel) for parcel in crew.executor.sent] == [1, 1, 1]


def test_all_that_was_on_its_way_to_a_broken_executor_is_carried_out_again_one_by_one():
    crew = Renewed(2, ["ok", "broken", "pending", "pending"], [])
    found = dict(carry_out(crew, square, range(6)))
    assert found == {i: i * i for i in range(6)}
    first, second = (executor.sent for executor in crew.used)
    doubtful = {piece for parcel in first for piece in parcel} - {0}
    assert [len(parcel) for parcel in second[: len(doubtful)]] == [1] * len(doubtful)
    assert {parcel[0] for parcel in second[: len(doubtful)]} == doubtful


def test_a_piece_that_breaks_the_executor_alone_for_the_second_time_is_given_up():
    crew = Renewed(1, ["broken"], ["broken"], [])
    found = dict(carry_out(crew, square, [7, 8]))
    assert isinstance(found[0], WorkerDied)
    assert found[1] == 64
    assert len(crew.used) == 3


def test_a_piece_that_was_only_beside_it_is_not_given_up():
    crew = Renewed(2, ["broken", "broken"], ["ok", "broken"], [])
    found = dict(carry_out(crew, square, [7, 8]))
    (innocent,), (culprit,) = crew.used[1].sent
    assert found[innocent - 7] == innocent**2
    assert isinstance(found[culprit - 7], WorkerDied)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ModuleNotFoundError("no", name="parapod"), "a worker cannot import parapod"),
        (BrokenExecutor(), "the executor is broken"),
        (CancelledError(), "its work was cancelled"),
    ],
)
def test_an_executor_that_is_of_no_use_is_told(error, words):
    with pytest.raises(NoWorkers, match=words):
        list(carry_out(Crew(Scripted([error]), 1), square, [1, 2]))


def test_what_the_work_raises_ends_it():
    with pytest.raises(ZeroDivisionError):
        list(carry_out(Crew(Scripted([ZeroDivisionError()]), 1), square, [1]))
