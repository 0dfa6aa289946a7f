"""Files of results: complete or not there at all."""

import json
import os
import re
import stat
from dataclasses import dataclass

import numpy as np
import pytest

from parapod.sims.output.atomic import atomic_output, check_writable, write_json
from parapod.sims.output.logs.files import LOG_FORMATS, read_log, write_experiment_log, write_log
from parapod.systems.core.errors import OutputError, ParapodError
from parapod.systems.core.schema import Schema, choice, quantity

needs_permissions = pytest.mark.skipif(
    os.name != "posix" or os.geteuid() == 0, reason="nothing is forbidden to this user"
)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_the_target_appears_only_when_the_block_is_over(tmp_path):
    target = tmp_path / "out.html"
    with atomic_output(target) as temporary:
        temporary.write_text("whole")
        assert temporary.parent == target.parent
        assert temporary.suffix == ".html"
        assert not target.exists()
    assert target.read_text() == "whole"
    assert names(tmp_path) == ["out.html"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit, ParapodError])
def test_after_an_exception_the_old_file_is_untouched_and_nothing_else_is_left(tmp_path, error):
    target = tmp_path / "out.txt"
    target.write_text("old")
    with pytest.raises(error), atomic_output(target) as temporary:  # noqa: PT012
        temporary.write_text("half")
        raise error
    assert target.read_text() == "old"
    assert names(tmp_path) == ["out.txt"]


def test_an_exception_before_anything_was_written_leaves_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), atomic_output(tmp_path / "out.txt"):
        raise ZeroDivisionError
    assert names(tmp_path) == []


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path):
    target = tmp_path / "out.txt"
    with pytest.raises(OutputError) as caught, atomic_output(target) as temporary:  # noqa: PT012
        temporary.write_text("half")
        raise OSError(28, "No space left on device")
    assert str(caught.value) == f"cannot write '{target}': No space left on device"
    assert caught.value.path == target
    assert names(tmp_path) == []


def test_a_block_that_writes_nothing_is_refused(tmp_path):
    with pytest.raises(OutputError, match="nothing was written"), atomic_output(tmp_path / "x"):
        pass


def test_the_target_has_the_permissions_of_any_new_file(tmp_path):
    (tmp_path / "ordinary").write_text("")
    write_json(tmp_path / "ours", {})
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("ordinary", "ours")]
    assert modes[0] == modes[1]


def test_a_symbolic_link_stays_and_its_file_is_replaced(tmp_path):
    (tmp_path / "real.json").write_text("old")
    (tmp_path / "link.json").symlink_to("real.json")
    write_json(tmp_path / "link.json", {"a": 1})
    assert (tmp_path / "link.json").is_symlink()
    assert json.loads((tmp_path / "real.json").read_text()) == {"a": 1}


def test_a_change_of_folder_within_the_block_does_no_harm(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    with atomic_output("out.txt") as temporary:
        temporary.write_text("x")
        monkeypatch.chdir(tmp_path / "elsewhere")
    assert names(tmp_path) == ["elsewhere", "out.txt"]


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("out/x.json", r"cannot write 'out/x\.json': the folder 'out' does not exist"),
        (".", r".* it is a directory"),
        ("file/x.json", r".* is not a directory"),
        ("into_missing", r".*out' does not exist"),
        ("to_itself", r"cannot write .*"),
        ("n" * 300, r".*File name too long"),
        # Refused rather than replaced.
        ("/dev/null", r".*not a regular file"),
    ],
)
def test_a_path_that_cannot_be_written_is_refused_with_the_reason(
    tmp_path, monkeypatch, path, words
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    (tmp_path / "into_missing").symlink_to(tmp_path / "out" / "x.json")
    (tmp_path / "to_itself").symlink_to("to_itself")
    with pytest.raises(OutputError) as caught:
        check_writable(path)
    assert re.fullmatch(words, str(caught.value))
    assert names(tmp_path) == ["file", "into_missing", "to_itself"]


@needs_permissions
def test_a_folder_without_permission_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(OutputError, match="no permission to write in"):
            check_writable(tmp_path / "x.json")
    finally:
        tmp_path.chmod(0o700)


@needs_permissions
def test_a_folder_that_may_not_be_searched_is_refused(tmp_path):
    locked = tmp_path / "locked"
    (locked / "inner").mkdir(parents=True)
    locked.chmod(0o000)
    try:
        with pytest.raises(OutputError, match="Permission denied"):
            check_writable(locked / "inner" / "x.json")
    finally:
        locked.chmod(0o700)


def test_no_permission_is_one_line_whoever_runs_this(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(OutputError, match="no permission to write in"):
        check_writable(tmp_path / "x.json")


def test_a_check_leaves_nothing(tmp_path):
    check_writable(tmp_path / "x.json")
    assert names(tmp_path) == []


def test_json_that_is_not_finite_leaves_the_old_file(tmp_path):
    target = tmp_path / "x.json"
    target.write_text("old")
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(target, {"a": float("nan")})
    assert target.read_text() == "old"


def test_a_log_comes_back_as_it_was(tmp_path):
    time = np.linspace(0.0, 1.0, 5)
    signals = {"legs.extension": np.random.default_rng(0).normal(size=(5, 4)), "fault": [0] * 5}
    write_log(tmp_path / "run.npz", time, signals, {"seed": 3, "note": "±"})
    log = read_log(tmp_path / "run.npz")
    np.testing.assert_array_equal(log.time, time)
    assert set(log.signals) == set(signals)
    np.testing.assert_array_equal(log.signals["legs.extension"], signals["legs.extension"])
    assert log.metadata == {"seed": 3, "note": "±"}


def test_a_log_is_readable_by_numpy_alone(tmp_path):
    write_log(tmp_path / "run.npz", [0.0, 1.0], {"imu.gyro": np.zeros((2, 3))}, {"seed": 3})
    with np.load(tmp_path / "run.npz", allow_pickle=False) as data:
        assert sorted(data.files) == ["imu.gyro", "metadata", "t"]
        assert json.loads(str(data["metadata"])) == {"seed": 3}


def test_the_same_log_is_the_same_file_under_any_name(tmp_path):
    for name in ("a.npz", "b.log"):
        write_log(tmp_path / name, [0.0], {"x": [1.0]}, {})
    assert names(tmp_path) == ["a.npz", "b.log"]
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.log").read_bytes()


@pytest.mark.parametrize(
    ("signals", "text"),
    [
        ({"x": np.zeros((3, 2))}, "not one row per 2 times"),
        ({"x": 1.0}, "not one row per 2 times"),
        ({"x": np.array([None, None])}, "not numeric"),
        ({"t": [0.0, 1.0]}, "cannot be called 't'"),
        ({"file": [0.0, 1.0]}, "cannot be called 'file'"),
    ],
)
def test_a_signal_that_cannot_be_logged_is_refused(tmp_path, signals, text):
    with pytest.raises(ValueError, match=text):
        write_log(tmp_path / "run.npz", [0.0, 1.0], signals, {})
    assert names(tmp_path) == []


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 broken", b"plain text", None, "npy", "npz"])
def test_a_file_that_is_no_log_is_refused(tmp_path, content):
    path = tmp_path / "run.npz"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content == "npy":
        with path.open("wb") as stream:
            np.save(stream, np.zeros(3))
    elif content == "npz":
        np.savez(path, x=np.zeros(3))
    with pytest.raises(OutputError, match="cannot read log"):
        read_log(path)


@dataclass
class Swing(Schema):
    """A scenario."""

    backend: str = choice("exact", ("exact",))
    seed: int = quantity(3, 0, 9)


@pytest.mark.parametrize("suffix", LOG_FORMATS)
def test_an_experiment_s_log_comes_back_from_every_format(tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    time = np.linspace(1.0, 2.0, 5) / 3.0
    random = np.random.default_rng(0)
    shapes = {"legs.extension": (5, 12), "feet": (5, 4, 3), "mass": (5,), "one": (5, 1)}
    signals = {name: (random.normal(size=shape), "m, m/s") for name, shape in shapes.items()}
    signals["legs.extension"][0][2, 11] = np.nan
    write_experiment_log(path, "swing", Swing(), time, signals)
    assert names(tmp_path) == [path.name]
    log = read_log(path)
    np.testing.assert_array_equal(log.time, time)
    assert list(log.signals) == list(signals)
    for name, (samples, unit) in signals.items():
        # A message of MCAP is a plain list.
        shape = (5, samples[0].size) if suffix == ".mcap" else samples.shape
        np.testing.assert_array_equal(log.signals[name], samples.reshape(shape))
        assert log.metadata["units"][name] == unit
    # A simulation's messages are stamped with its own time, which is the same in every run.
    assert suffix != ".mcap" or log.metadata["wall_time"] == pytest.approx(time[0])
    assert log.metadata["experiment"] == "swing"
    assert log.metadata["scenario"] == "backend: exact\nseed: 3\n"


def test_a_table_is_readable_by_numpy_alone(tmp_path):
    path = tmp_path / "run.csv"
    signals = {"gyro": (np.ones((2, 3)), "rad/s"), "mass": ([4.0, 5.0], "kg")}
    write_experiment_log(path, "swing", Swing(), [0.0, 0.5], signals)
    head, columns, *_ = path.read_text().splitlines()
    assert head.startswith("# {")
    assert columns == "t,gyro[0],gyro[1],gyro[2],mass"
    table = np.genfromtxt(path, delimiter=",", skip_header=2)
    np.testing.assert_array_equal(table, [[0.0, 1, 1, 1, 4], [0.5, 1, 1, 1, 5]])


def test_a_log_of_unknown_format_is_refused(tmp_path):
    with pytest.raises(OutputError, match=r"suffix must be one of \.npz, \.mcap, \.csv"):
        write_experiment_log(tmp_path / "run.txt", "swing", Swing(), [0.0], {})
    assert names(tmp_path) == []


@pytest.mark.parametrize("text", ["", "a,b\n1,2\n", "# {}\nt,x[\n1,2\n", "# {}\nt,x\n1\n"])
def test_a_table_that_is_no_log_is_refused(tmp_path, text):
    path = tmp_path / "run.csv"
    path.write_text(text)
    with pytest.raises(OutputError, match="cannot read log"):
        read_log(path)
    with pytest.raises(OutputError, match="No such file"):
        read_log(tmp_path / "none.csv")
