"""Logs on a page and in figures, through the command."""

import base64
import gzip
import json
import re
import urllib.error
import urllib.request
from dataclasses import replace
from threading import Thread

import numpy as np
import pytest
from rich.console import Console

from parapod.diagrams.machine import find_machine
from parapod.sims.cli.main import main
from parapod.sims.lab.discovery import find_entry, find_experiment
from parapod.sims.lab.serve import PageServer
from parapod.sims.output.logs.files import read_log, write_experiment_log
from parapod.sims.output.logs.mcap import McapWriter
from parapod.sims.replay import digest as digests
from parapod.sims.replay.page import make_page
from parapod.sims.replay.replay import least_ends, near_limits, open_replays
from parapod.systems.walking_chair.chair import chair_inverse
from parapod.systems.walking_chair.gait import TrotGait, Walk
from parapod.systems.walking_chair.geometry import ChairGeometry

CHAIR_GEOMETRY = ChairGeometry()

pytest.importorskip("plotly")
MACHINE = find_machine("machining_centre")
COUNT = 40


def write(
    path, experiment="centre-walk", left_out=(), shift=0.0, backend="kinematic", count=COUNT
):
    """A log of a centre whose platform rises through three phases."""
    scenario = MACHINE.scenario(backend="kinematic")
    limbs, time = scenario.limbs, 0.1 * np.arange(count)
    pose = np.tile([0.0, 0.0, 0.5, 0.0, 0.0, 0.0], (count, 1))
    pose[:, 2] += 0.01 * np.arange(count) / COUNT + shift
    angles = 2.0 * np.pi * np.arange(limbs) / limbs
    feet = np.zeros((limbs, 6))
    feet[:, 0], feet[:, 1], feet[:, 5] = 0.4 * np.cos(angles), 0.4 * np.sin(angles), angles
    signals = {
        "pose_estimated": pose,
        "pose_desired": pose + 0.001,
        "feet_estimated": np.tile(feet.ravel(), (count, 1)),
        "legs.position": 0.5 + 0.0 * np.zeros((count, 2 * limbs)),
        "phase": (np.arange(count) // (count // 3 + 1) + 1.0)[:, None],
    }
    units = {name: (each, MACHINE.unit(name)) for name, each in signals.items()}
    kept = {name: each for name, each in units.items() if name not in left_out}
    find_experiment("centre-walk").write_log(path, scenario, time, kept)
    return path


@pytest.fixture
def log(work):
    return write(work / "walk.npz")


def page_of(path):
    """Content, and Meshcat's page, of a page."""
    text = path.read_text()
    assert not re.search(r"<script[^>]*\bsrc=|<link[^>]*\bhref=\"(?!data:)", text)
    (content,) = re.findall(r'<script type="application/json" id="content">(.*?)</script>', text)
    packed = re.findall(r'<script type="text/plain" id="meshcat">(.*?)</script>', text)
    scene = gzip.decompress(base64.b64decode(packed[0])).decode() if packed else None
    return text, json.loads(content), scene


def numbers(array):
    return np.frombuffer(base64.b64decode(array["bdata"]), f"<{array['dtype']}")


def test_a_page_has_the_machine_its_plots_and_its_phases(log, capsys):
    assert main(["replay", str(log), "--html", "walk.html"]) == 0
    assert capsys.readouterr().out == "wrote walk.html\n"
    text, content, scene = page_of(log.with_suffix(".html"))
    assert "<title>centre-walk: the machining centre - parapod</title>" in text
    assert "set_animation" in scene or "setAnimation" in scene or len(scene) > 2e6
    assert (content["begin"], content["end"]) == (0.0, pytest.approx(3.9))
    names = [phase["name"] for phase in content["phases"]]
    assert names == ["machining", "reconfiguration", "lock"]
    assert content["phases"][0]["end"] == content["phases"][1]["begin"] == pytest.approx(1.4)
    height = next(each for each in content["traces"] if each["hovertemplate"].count("ated[2]"))
    np.testing.assert_allclose(numbers(height["x"]), 0.1 * np.arange(COUNT))
    np.testing.assert_allclose(numbers(height["y"]), 500.0 + 10.0 * np.arange(COUNT) / COUNT, 1e-6)
    assert "mm" in height["hovertemplate"]
    titles = [content["layout"][f"yaxis{k}"]["title"]["text"] for k in ("", 2, 3)]
    assert titles == ["[mm]", "[deg]", "legs position [mm]"]


def test_a_page_tells_when_its_log_was_written_not_when_it_is_replayed(log, monkeypatch):
    written = read_log(log).metadata["written"]
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC", written)
    for suffix in ("csv", "mcap", "npz"):
        path = log.with_suffix(f".{suffix}")
        with monkeypatch.context() as then:
            then.setattr("parapod.sims.output.logs.files.moment", lambda: "2020-02-02 20:02 UTC")
            write(path)
        assert main(["replay", str(path), "--html", "walk.html"]) == 0
        text, _, scene = page_of(log.with_suffix(".html"))
        (origin,) = re.findall("<p>(.*?)</p>", text)
        assert origin.startswith(f"walk.{suffix} · backend ")
        assert origin.endswith(" · 2020-02-02 20:02 UTC")
        assert "#status-message" in scene.partition("<body>")[0]  # hidden from the beginning


def test_two_logs_share_a_scene_and_the_other_one_is_dashed_and_translucent(log, capsys):
    other = write(log.with_name("other.csv"), shift=0.02, left_out=["legs.position"])
    assert main(["replay", str(log), "--against", str(other), "--html", "both.html"]) == 0
    assert "other.csv has no legs.position[0]" in capsys.readouterr().err
    _, content, scene = page_of(log.with_name("both.html"))
    dashes = [trace["line"]["dash"] for trace in content["traces"]]
    assert dashes.count("solid") == 18
    assert len(dashes) == 18 + 12
    first, second = (
        [t for t in content["traces"] if t["legendgroup"] == "0 pose_estimated[2]"][k]
        for k in range(2)
    )
    assert first["line"]["color"] == second["line"]["color"]
    difference = numbers(second["y"]) - numbers(first["y"])
    np.testing.assert_allclose(difference, 20.0, rtol=1e-4)
    assert content["pale"]["/drake/other_measured"] == 0.4
    assert scene is not None


def test_curves_that_only_the_other_log_has_are_drawn_of_it_in_their_own_colours(log, capsys):
    both, alone = (
        write(log.with_name(f"{name}.npz"), left_out=left_out)
        for name, left_out in (("whole", ()), ("bare", ["legs.position"]))
    )
    asked = ["--plot", "pose_desired[0]+pose_estimated[0]", "--plot", "legs.position[0:2]"]
    assert main(["replay", str(alone), "--against", str(both), *asked, "--html", "a.html"]) == 0
    assert "bare.npz has no legs.position[0], legs.position[1]" in capsys.readouterr().err
    _, content, _ = page_of(log.with_name("a.html"))
    legs = [trace for trace in content["traces"] if trace["legendgroup"].startswith("1 ")]
    assert [trace["showlegend"] for trace in legs] == [True, True]
    assert [trace["line"]["dash"] for trace in legs] == ["5px,3px"] * 2
    assert (
        main(
            [
                "plot",
                str(alone),
                "legs.position[1]+pose_desired[0]",
                "--against",
                str(both),
                "--out",
                "a.png",
            ]
        )
        == 0
    )
    assert main(["plot", str(alone), "nothing", "--against", str(both)]) == 2
    line = capsys.readouterr().err
    assert "no signal 'nothing' in " in line
    assert "whole.npz'; there are: " in line


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (
            "pose_estimatd",
            r"no signal 'pose_estimatd' in '.*' \(did you mean pose_estimated\?\); .*",
        ),
        ("pose_estimated[6]", r"'pose_estimated' has elements 0 to 5, not '\[6\]'"),
        ("pose_estimated[2:2]", r"'pose_estimated' has elements 0 to 5, not '\[2:2\]'"),
        ("phase[1]", r"'phase' has element 0 only, not '\[1\]'"),
        ("pose_estimated+nothing", r"no signal 'nothing' in '.*'; there are: pose_estimated, .*"),
    ],
)
def test_a_signal_that_is_not_there_is_refused_with_those_that_are(log, asked, words, capsys):
    for command in (
        ["replay", str(log), "--plot", asked, "--html", "a.html"],
        ["plot", str(log), asked],
    ):
        assert main(command) == 2
        line = capsys.readouterr().err
        assert re.fullmatch(rf"parapod: error: .*{words}\n", line)
    assert [path.name for path in log.parent.iterdir()] == ["walk.npz"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"parapod": "9.9"}, r"walk\.npz was written by parapod 9\.9, this is .*"),
        (
            {"experiment": "ballet"},
            r".* not drawn: there is no experiment 'ballet'; .*",
        ),
        ({"experiment": None}, r".* not drawn: the log does not show its experiment"),
        ({"experiment": "centre-locks"}, r".* not drawn: .*"),
        ({"scenario": "limbs: 3\nlegz: 1\n"}, r".* not drawn: .*unknown key 'legz'.*"),
        ({"scenario": "backend: kinematic\nhardware: {drivers: [!Alien {}]}\n"}, r""),
        (
            {"scenario": "backend: kinematic\nlimbs: 4\n"},
            r".* not drawn: \S+ of the drawing has \d+ .*",
        ),
    ],
)
def test_a_log_from_elsewhere_is_shown_as_far_as_it_can_be(log, change, words, capsys):
    with np.load(log) as archive:
        arrays = dict(archive)
    metadata = {**json.loads(str(arrays.pop("metadata"))), **change}
    metadata = {name: value for name, value in metadata.items() if value is not None}
    np.savez(log, metadata=np.array(json.dumps(metadata)), **arrays)
    assert main(["replay", str(log), "--html", "walk.html"]) == 0
    said = capsys.readouterr().err
    assert re.fullmatch(f"parapod: {words}\n" if words else "", said)
    _, content, scene = page_of(log.with_suffix(".html"))
    assert content["traces"]
    assert (scene is None) == ("not drawn" in words)


def test_a_log_without_what_it_is_drawn_by_says_so(work, capsys):
    log = write(work / "walk.mcap", left_out=["feet_estimated"])
    assert main(["replay", str(log), "--html", "walk.html"]) == 0
    assert capsys.readouterr().err == (
        "parapod: walk.mcap: the machine is not drawn: the log has no feet_estimated\n"
    )


def test_a_log_that_is_cut_off_says_how_far_it_goes(work, capsys):
    from mcap.reader import make_reader

    log = write(work / "walk.mcap")
    with log.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    cut = min(each.chunk_start_offset for each in chunks if each.message_start_time > 2e9)
    log.write_bytes(log.read_bytes()[: cut + 20])
    assert main(["replay", str(log), "--html", "walk.html"]) == 0
    said = capsys.readouterr().err
    (end,) = re.fullmatch(
        r"parapod: walk\.mcap is cut off; it is shown up to ([\d.]+) s\n", said
    ).groups()
    _, page, _ = page_of(work / "walk.html")
    assert page["end"] == pytest.approx(float(end))
    assert page["end"] < 3.9


def test_times_without_a_sample_are_refused_with_those_that_have_some(log, capsys):
    assert main(["plot", str(log), "--between", "7", "8"]) == 2
    assert (
        "has no sample from 7 to 8 s; its samples are from 0 to 3.9 s" in capsys.readouterr().err
    )
    replay, _ = open_replays(log, None, (), Console(quiet=True), between=(1.0, 2.0))
    assert (replay.digest.begin, replay.digest.end) == (1.0, 2.0)


def test_a_long_log_is_thinned_keeps_a_spike_and_says_so(work, monkeypatch, capsys):
    monkeypatch.setattr(digests, "_BUCKETS", 20)
    monkeypatch.setattr(digests, "_PICTURES", 16)
    log = write(work / "walk.npz", count=1000)
    with np.load(log) as archive:
        arrays = dict(archive)
    arrays["legs.position"][617, 3] = 0.7
    np.savez(log, **arrays)
    replay, _ = open_replays(log, None, ["legs.position"], Console(quiet=True))
    line = replay.digest.lines["legs.position"]
    assert len(line.time) < 100
    assert line.values[:, 3].max() == 0.7
    pictures = [time for time, _ in replay.digest.pictures]
    assert 8 <= len(pictures) <= 16
    np.testing.assert_allclose(np.diff(pictures), 6.4)
    remark, drawn = replay.remarks
    assert drawn == "walk.npz: the machine is drawn every 6.4 s"
    assert "1000 samples; curves show smallest and largest values of each 64 of them" in remark


@pytest.mark.parametrize("suffix", ["svg", "png", "pdf"])
def test_a_plot_is_a_figure_with_units_limits_and_phases(work, suffix, capsys):
    path = write(work / "walk.npz")
    assert main(["plot", str(path), "pose_estimated[2]", "--out", f"a.{suffix}"]) == 0
    content = (work / f"a.{suffix}").read_bytes()
    starts = {"svg": b"<?xml", "png": b"\x89PNG", "pdf": b"%PDF"}
    assert content.startswith(starts[suffix])
    if suffix == "svg":
        for words in (
            "pose estimated[2]",
            "[mm]",
            "time [s]",
            "machining",
            "walk.npz (backend kinematic",
        ):
            assert words in content.decode()


def test_limits_of_the_machine_are_drawn(work):
    platform = find_machine("levelling_platform")
    extension = np.linspace(0.39, 0.41, 5)[:, None] * np.ones(4)
    path = work / "level.npz"
    signals = {"legs.extension": (extension, "m"), "imu.gyro": (extension[:, :3], "rad/s")}
    write_experiment_log(path, "level", platform.scenario(), np.arange(5), signals)
    replay, _ = open_replays(path, None, ["legs.extension", "imu.gyro"], Console(quiet=True))
    legs, gyro = replay.plots
    assert (legs.unit, gyro.unit) == ("mm", "deg/s")
    assert legs.limits == pytest.approx((380.0, 460.0))
    assert gyro.limits == pytest.approx((-1000.0, 1000.0), rel=1e-3)
    assert near_limits([replay], 0) == pytest.approx([380.0])  # 460 mm is far from 390..410
    assert near_limits([replay], 1) == []


def chair_log(path, left_out=()):
    """A log of a chair that walks two steps ahead, by closed forms."""
    chair = find_machine("walking_chair")
    walk = replace(TrotGait(), cycles=2, body_law="ramped")
    time = np.arange(0.0, Walk((walk,)).duration, 0.05)
    motion = Walk((walk,)).motions(CHAIR_GEOMETRY, time)
    body, feet = np.asarray(motion.body.position), motion.feet.position
    lengths = chair_inverse(CHAIR_GEOMETRY, body, np.eye(3), feet, motion.references)
    signals = {
        "legs.position": lengths.reshape(len(time), -1),
        "position_node": lengths.reshape(len(time), -1),
        "support": np.asarray(motion.support, float),
    }
    units = {n: (s, chair.unit(n)) for n, s in signals.items() if n not in left_out}
    scenario = chair.scenario(backend="kinematic")
    scenario.gait.cycles = 2
    write_experiment_log(path, "chair-walk", scenario, time, units)
    return path, body


def bodies(twin):
    """Places of the chair's body in both drawings."""
    places = {}
    for drawing, (graph, context) in twin.scene_graphs().items():
        inspector = graph.model_inspector()
        (frame,) = (f for f in inspector.GetAllFrameIds() if "body::" in inspector.GetName(f))
        query = graph.get_query_output_port().Eval(context)
        places[drawing] = query.GetPoseInWorld(frame).translation()
    return places


def test_a_chair_that_is_watched_is_drawn_where_its_steps_lead_it(work):
    log, body = chair_log(work / "walk.npz")
    replay, _ = open_replays(log, None, (), Console(quiet=True))
    subject, shown = replay.subject, replay.digest.pictures
    twin = subject.drawn.make()
    for _, row in [*shown[::20], shown[-1]]:  # without what is tracked, as a page has it
        twin.show({name: row[name] for name in subject.drawn.sources})
    for place in bodies(twin).values():
        np.testing.assert_allclose(place[:2], body[-1, :2], atol=2e-3)


@pytest.mark.parametrize("left_out", [(), ("support", "position_node")])
def test_a_chair_is_at_the_same_place_however_few_pictures_there_are(work, left_out, monkeypatch):
    log, body = chair_log(work / "walk.npz", left_out)

    def place(pictures, between=None):
        monkeypatch.setattr(digests, "_PICTURES", pictures)
        replay, _ = open_replays(log, None, (), Console(quiet=True), between=between)
        subject, shown = replay.subject, replay.digest.pictures
        twin = subject.drawn.make()
        time, row = shown[-1]
        twin.show(subject.drawn.values(row), time)
        return time, bodies(twin)

    (last, all_of_them), (early, few) = place(10_000), place(4)
    assert early < last - 1.0
    _, until = place(10_000, (early - 1.0, early + 1e-9))
    for drawing in ("measured", "desired"):
        np.testing.assert_allclose(all_of_them[drawing][:2], body[-1, :2], atol=1e-3)
        np.testing.assert_allclose(few[drawing], until[drawing], atol=1e-12)
    assert few["measured"][1] > 0.02


def test_a_log_of_one_leg_is_drawn_as_a_leg_in_the_scene_of_its_machine(work, capsys):
    count, lengths = 5, np.linspace((0.62, 0.63, 0.62), (0.64, 0.62, 0.63), 5)
    signals = {"compound.position": (lengths, "m"), "position_desired": (lengths + 1e-3, "m")}
    scenario = find_entry("chair-circle").load().schema()
    path = work / "circle.npz"
    write_experiment_log(path, "chair-circle", scenario, np.arange(count), signals)
    assert main(["replay", str(path), "--html", "circle.html"]) == 0
    assert capsys.readouterr().err == "parapod: circle.npz: the machine is drawn every 1 s\n"
    _, content, scene = page_of(work / "circle.html")
    assert scene is not None
    drawn = [each["hovertemplate"] for each in content["traces"]]
    assert sum("compound.position" in each for each in drawn) == 3


def test_a_job_on_a_real_machine_has_the_plots_and_the_drawing_of_its_machine(work):
    extension = np.linspace(0.39, 0.41, 5)[:, None] * np.ones(4)
    signals = {"legs.extension": (extension, "m"), "attitude_estimated": (np.zeros((5, 2)), "rad")}
    scenario = find_entry("identify-actuators").load().schema()
    write_experiment_log(work / "a.npz", "identify-actuators", scenario, np.arange(5), signals)
    replay, _ = open_replays(work / "a.npz", None, (), Console(quiet=True))
    assert replay.subject.drawn.sources == {name: name for name in signals}
    drawn = {curve.signal for plot in replay.plots for curve in plot.curves}
    assert drawn == {"legs.extension", "attitude_estimated"}


def test_elements_have_limits_of_their_own(work):
    log, _ = chair_log(work / "walk.npz")
    asked = ["legs.position[0]", "legs.position[1]", "legs.position[3:5]"]
    replay, _ = open_replays(log, None, asked, Console(quiet=True), is_drawn=False)
    up, ups, both = (plot.limits for plot in replay.plots)
    assert up == pytest.approx((591.4, 891.4))
    assert ups == pytest.approx((574.0, 874.0))
    assert both == pytest.approx((574.0, 591.4, 874.0, 891.4))
    # Lines have the colours of the curves that they are of, where these differ.
    assert [replay.plots[2].place_of_limit(limit) for limit in both] == [1, 0, 1, 0]
    assert replay.plots[0].place_of_limit(up[0]) is None


def test_without_a_screen_no_window_is_opened_and_a_file_is_asked_for(log, monkeypatch, capsys):
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.delenv("DISPLAY", raising=False)
    assert main(["plot", str(log)]) == 2
    assert re.search(
        r"no window can be opened: .*; name a file with --out", capsys.readouterr().err
    )


def test_a_page_is_served_to_this_computer_only():
    with PageServer("<p>walk</p>") as server:
        Thread(target=server.serve_forever, daemon=True).start()
        with urllib.request.urlopen(server.url) as answer:
            assert answer.read() == b"<p>walk</p>"
        stranger = urllib.request.Request(server.url, headers={"Host": "evil.example"})
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(stranger)
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"{server.url}/other")
        server.shutdown()


def live_log(path, begins, first=1, is_whole=True):
    """An MCAP log whose loop begins at a time of the wall clock [s], of a leg that goes as that.

    Its first sample is so many periods later.
    """
    pytest.importorskip("mcap")
    pytest.importorskip("rosbags")
    with path.open("wb") as stream:
        writer = McapWriter(stream, {"legs.position": "m"}, (6,), {"experiment": "centre-walk"})
        for time in 0.1 * np.arange(first, first + COUNT):
            stamp = begins + time
            writer.write(round(1e9 * stamp), time, np.full(6, 1e-3 * (stamp - NOON)))
        writer.flush()
        if is_whole:
            writer.finish()
    return path


NOON = 1_790_000_000.0  # [s]


@pytest.mark.parametrize("is_whole", [True, False])
@pytest.mark.parametrize(
    ("begins", "moved"),
    [(1.5, 1.5), (-2.0, -2.0), (3.7, 3.7), (4.5, 0.0), (-4.5, 0.0), (86400.0, 0.0)],
)
def test_logs_of_the_same_time_are_laid_over_each_other_by_the_clock(
    work, begins, moved, is_whole
):
    one = live_log(work / "machine.mcap", NOON)
    two = live_log(work / "emulated.mcap", NOON + begins, first=2, is_whole=is_whole)
    replay, other = open_replays(one, two, ["legs.position"], Console(quiet=True))
    assert replay.digest.begin == pytest.approx(0.1)
    assert other.digest.begin == pytest.approx(0.2 + moved)
    said = [text for text in other.remarks if "by the computer's clock" in text]
    assert len(said) == (moved != 0.0)
    if moved:
        way = "later" if moved > 0.0 else "earlier"
        assert (
            f"emulated.mcap was written at the same time: {said[0].partition(': ')[2]}" == said[0]
        )
        assert f"{abs(moved):.2f} s {way} than by its own time" in said[0]
        # Where both are, they now tell the same.
        lines = [each.digest.lines["legs.position"] for each in (replay, other)]
        shared = np.intersect1d(*(line.time.round(6) for line in lines))
        at = [line.values[np.isin(line.time.round(6), shared), 0] for line in lines]
        np.testing.assert_allclose(*at, atol=1e-9)
    between = open_replays(
        one, two, ["legs.position"], Console(quiet=True), between=(1.95, 4.0 + max(moved, 0.0))
    )
    assert between[1].digest.begin == pytest.approx(max(2.0, 0.2 + moved))


def test_a_simulation_is_laid_by_its_own_time(work):
    one, two = live_log(work / "machine.mcap", NOON), live_log(work / "simulated.mcap", 0.0)
    _, other = open_replays(one, two, ["legs.position"], Console(quiet=True))
    assert other.digest.begin == pytest.approx(0.1)
    assert not [text for text in other.remarks if "clock" in text]


def test_rounding_fills_no_plot(work):
    path, time = work / "walk.npz", np.arange(40.0)
    pose = np.zeros((40, 6))
    pose[:, 0], pose[:, 3], pose[:, 4] = 0.3 + 1e-9 * (time % 2), 1e-6 * (time % 2), 1e-3 * time
    scenario = MACHINE.scenario(backend="kinematic")
    write_experiment_log(
        path,
        "centre-walk",
        scenario,
        time,
        {"pose_estimated": (pose, MACHINE.unit("pose_estimated"))},
    )
    names = [f"pose_estimated[{k}]" for k in (0, 3, 4)]
    replay, _ = open_replays(path, None, names, Console(quiet=True))
    length, still, turning = (least_ends([replay], k) for k in range(3))
    assert length == pytest.approx((299.995, 300.005), abs=1e-5)
    assert still == pytest.approx((-0.005, 0.005), abs=1e-4)
    assert turning is None
    page = make_page(replay, None, None)
    assert page.count('"autorangeoptions"') == 2
