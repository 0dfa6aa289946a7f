"""What is said about a computer on which something is measured."""

import pytest

from parapod.sims.real_machine.computer import Throttling, this_computer, watched_throttling


@pytest.fixture
def root(tmp_path):
    """root(**files): a folder with files of /proc and /sys, `__` for the slashes."""

    def make(**files):
        for name, text in files.items():
            path = tmp_path / name.replace("__", "/")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return tmp_path

    return make


DYNAMIC = "#1 SMP PREEMPT_DYNAMIC Mon Jul 1\n"


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"proc__sys__kernel__version": "#1 SMP PREEMPT_RT Mon\n"}, "PREEMPT_RT"),
        ({"proc__sys__kernel__version": DYNAMIC, "sys__kernel__realtime": "1\n"}, "PREEMPT_RT"),
        ({"proc__sys__kernel__version": "#1 SMP PREEMPT Mon\n"}, "PREEMPT"),
        ({"proc__sys__kernel__version": "#1 SMP Mon\n"}, "none or voluntary"),
        ({"proc__sys__kernel__version": DYNAMIC}, "PREEMPT_DYNAMIC, mode unreadable"),
        (
            {
                "proc__sys__kernel__version": DYNAMIC,
                "sys__kernel__debug__sched__preempt": "none (voluntary) full lazy\n",
            },
            "PREEMPT_DYNAMIC, voluntary",
        ),
        ({}, "not readable"),
    ],
)
def test_the_preemption_model_is_named(root, files, words):
    assert this_computer(root(**files)).preemption == words


def test_cores_governors_and_throttling_are_read(root):
    computer = this_computer(
        root(
            sys__devices__system__cpu__isolated="2-3\n",
            sys__devices__system__cpu__nohz_full="(null)\n",
            sys__devices__system__cpu__cpu0__cpufreq__scaling_governor="powersave\n",
            sys__devices__system__cpu__cpu1__cpufreq__scaling_governor="performance\n",
            proc__sys__kernel__sched_rt_period_us="1000000\n",
            proc__sys__kernel__sched_rt_runtime_us="950000\n",
        )
    )
    assert (computer.isolated, computer.nohz_full) == ((2, 3), ())
    assert computer.share == pytest.approx(0.95)
    text = "\n".join(computer.lines())
    for words in ("isolated: 2,3", "performance, powersave", "950000 of each 1000000 us"):
        assert words in text
    assert "rtprio" in text


@pytest.mark.parametrize(
    ("runtime", "share", "words"), [("-1", 1.0, "off (sched_rt"), ("", 1.0, "not readable")]
)
def test_real_time_programs_that_are_not_throttled_get_all_of_a_core(root, runtime, share, words):
    files = {"proc__sys__kernel__sched_rt_period_us": "1000000\n"} if runtime else {}
    files |= {"proc__sys__kernel__sched_rt_runtime_us": f"{runtime}\n"} if runtime else {}
    computer = this_computer(root(**files))
    assert computer.share == share
    assert any(words in line for line in computer.lines())


def stat(*cores):
    """Lines of /proc/stat of cores with so many ticks busy and idle."""
    lines = ["cpu  0 0 0 0 0 0 0 0 0 0"]
    lines += [f"cpu{i} {busy} 0 0 {idle} 5 0 0 0 0 0" for i, (busy, idle) in enumerate(cores)]
    return "\n".join([*lines, "intr 12"])


def test_a_second_in_which_no_core_was_full_was_not_throttled():
    watch = Throttling(0.95)
    for second in range(4):
        watch.look(stat((90 * second, 10 * second), (10 * second, 90 * second)))
    assert (watch.seconds, watch.full) == (3, 0)
    assert watch.words == "not throttled: no core was busy for more than 90 % of a second"


def test_a_second_in_which_a_core_was_full_may_have_been_throttled():
    watch = Throttling(0.95)
    for busy, idle in ((0, 0), (50, 50), (149, 51), (199, 101)):
        watch.look(stat((busy, idle), (0, 100 + busy + idle)))
    assert (watch.seconds, watch.full) == (3, 1)
    assert watch.words.startswith("perhaps throttled: in 1 of 3 s a core was busy")
    assert Throttling(1.0).words.startswith("not throttled: it is off")
    assert Throttling(0.95).words.startswith("nothing is known")


def test_what_the_kernel_says_of_throttling_counts(root):
    folder = root(
        proc__stat=stat((1, 1)),
        dev__kmsg="4,900,9999999999999,-;sched: RT throttling activated\n",
    )
    with watched_throttling(this_computer(folder), folder) as watch:
        pass
    assert watch.words == "throttled: the kernel's log says so"
    folder = root(dev__kmsg="4,900,1,-;sched: RT throttling activated\n")  # long ago
    with watched_throttling(this_computer(folder), folder) as watch:
        pass
    assert not watch.is_told
