"""Law of every refusal of the command: one line that says what, where and what is allowed."""

import re
from pathlib import Path

import pytest

from parapod.sims.cli.main import main

_LONG = "x" * 10_000
_KINDS = "off, stuck, garbage, wrong, slow, delayed, intermittent"
_STEEP = "ground.roll_deg=3 ground.pitch_deg=5 job.estimate_at=1.5"
_BRANCH = r"branch 1[123] would need a length of"

# Command line, and the line that is said. A list is taken word by word, a text is split.
REFUSALS = [
    # --- the command line
    ("walk", r"argument COMMAND: invalid choice: 'walk' .*"),
    ("run", r"the following arguments are required: NAME \(see parapod run --help\)"),
    ("run level --sed 3", r"unrecognized arguments: --sed 3 \(see parapod --help\)"),
    ("run level job.end=3", r"unrecognized .*: job.end=3; keys of a scenario follow --set .*"),
    ("run level --set", r"argument --set: expected at least one argument \(see parapod run .*"),
    ("run level --turntable", r"the experiment 'level' has no option --turntable"),
    ("run levle", r"there is no experiment 'levle'; there are: .* \(did you mean level\?\)"),
    ("scenario levle", r"there is no experiment 'levle'; there are: .*"),
    # --- whatever is typed, one line of reasonable length
    (["list", "\n"], r"unrecognized arguments: \\n \(see parapod --help\)"),
    (["list", _LONG], r"unrecognized arguments: xxx.*"),
    (["wa\nlk"], r"argument COMMAND: invalid choice: 'wa\\nlk'.*"),
    ([_LONG], r"argument COMMAND: invalid choice: 'xxx.*"),
    (["run", "a\nb"], r"there is no experiment 'a\\nb'; there are: .*"),
    (["run", "\x1b[31m"], r"there is no experiment '\\x1b\[31m'; there are: .*"),
    (["run", _LONG], r"there is no experiment 'xxx.*"),
    (["run", "level", "--set", "x\ny=1"], r"unknown key 'x\\ny'; allowed: .*backend, .*"),
    (["run", "level", "--set", f"{_LONG}=1"], r"unknown key 'xxx.*"),
    (["run", "level", "--set", f"ground.{_LONG}=1"], r"unknown key 'ground.xxx.*"),
    (["run", "level", "--set", "a\tb"], r"override 'a\\tb' is not of the form key=value"),
    (["run", "level", "--backend", "a\nb"], r"backend = 'a b' is not one of multibody, .*"),
    (["run", "level", "--seeds", "1\n2"], r"argument --seeds: must be a whole number of 1 or.*"),
    (["run", "level", "--seeds", "9" * 10_000], r"argument --seeds: .*"),
    (["run", "level", "--scenario", "a\nb"], r"scenario file 'a\\nb' does not exist"),
    (["run", "level", "--scenario", _LONG], r"scenario file 'xxx.*"),
    (["run", "level", "--json", "a\n/b"], r"cannot write 'a\\n/b': the folder 'a\\n' does not.*"),
    (["run", "level", "--json", _LONG], r"cannot write 'xxx.*"),
    (["run", "level", "--drivers", "a\nb"], r"drivers 'a\\nb': there is no such Python file"),
    (["bench-rt", "--of", "a\nb"], r"there is no experiment 'a\\nb'; there are: .*"),
    (["check", "le\ngs", "--of", _LONG], r"there is no experiment 'xxx.*"),
    # --- parts
    ("check ram", r"part 'ram' is not one of legs, imu, wheels, arm"),
    *(
        (
            f"check {arguments}",
            rf"part '{arguments.split()[0]}' is not fitted, .*; fitted: {parts}",
        )
        for arguments, parts in (
            ("arm", "legs, imu, wheels"),
            ("arm --move 1 --yes", "legs, imu, wheels"),
            ("leg --of bench-walk", "sliders, hip, cells"),
            ("belt --of bench-walk", "sliders, hip, cells"),  # its zeros would be read
        )
    ),
    # --- scenarios; `run` and `scenario` refuse the same
    *(
        (f"{command} level {arguments}", words)
        for command in ("run", "scenario")
        for arguments, words in (
            (
                "--set ground.pich_deg=1",
                r"unknown key 'ground\.pich_deg'; allowed under 'ground': .*pitch_deg.*",
            ),
            ("--set ground.pitch_deg=40", r"ground\.pitch_deg = 40 is outside -15\.\.15"),
            ("--set ground.pitch_deg", r"override 'ground\.pitch_deg' is not of the form key=.*"),
            ("--seed x", r"seed must be a whole number, not 'x'"),
            ("--seed -1", r"seed = -1 is outside 0\.\.2147483647"),
            (
                "--backend kinmatic",
                r"backend = 'kinmatic' is not one of multibody, kinematic, mujoco, mock, hardware "
                r"\(did you mean kinematic\?\)",
            ),
            ("--scenario x.yaml", r"scenario file 'x\.yaml' does not exist"),
        )
    ),
    (
        "run deploy --backend mock",
        r"backend = 'mock' is not one of multibody, kinematic.*",
    ),
    (
        "run track-posture --backend mock",
        r"backend = 'mock' is not one on which 'track-posture' runs; there are: multibody, .*",
    ),
    # --- files
    *(
        (["run", "level", f"--{option}", path], words)
        for option in ("html", "json", "log", "graphviz")
        for path, words in (
            ("out/x", r"cannot write 'out/x': the folder 'out' does not exist"),
            ("", r"cannot write '.*': it is a directory"),
        )
    ),
    ("run level --json x --log ./x", r"--json and --log would both write 'x'"),
    ("run level --json x --figures ./x", r"--json and --figures would both write 'x'"),
    *(
        (["run", "level", "--figures", folder], words)
        for folder, words in (
            ("/dev/null", r"cannot make the folder '/dev/null': '/dev/null' is not a directory"),
            ("/dev/null/x", r"cannot make the folder '/dev/null/x': '/dev/null' is not a .*"),
            (_LONG, r"cannot make the folder 'xxx.*: File name too long"),
        )
    ),
    ("run level --log x.txt", r"cannot write 'x\.txt': a log's suffix must be one of \.npz, .*"),
    (
        "run level --graphviz x.xyz --backend kinematic",
        r"cannot write 'x\.xyz': a diagram's suffix must be one of \.dot, \.gv, \.svg, .*",
    ),
    ("run level --html x.mp4", r"--html writes \.html or \.htm, not 'x\.mp4'"),
    ("run level --json x.html", r"--json writes \.json, not 'x\.html'"),
    ("run level --video x.avi", r"--video writes \.mp4 or \.webm or \.gif, not 'x\.avi'"),
    ("run level --video x", r"--video writes .* not 'x'"),
    ("run level --video x.gif --seeds 2", r"--video shows a single run .*"),
    ("run workspace --video x.gif", r"--video has nothing to film of 'workspace'"),
    (
        "run level --figures x --width-mm 5",
        r".*--width-mm: must be from 40 to 1000 mm, not '5' .*",
    ),
    ("run level --style none", r"cannot read the style 'none': no such file"),
    ("run level --figures x --figure-format eps", r".*--figure-format: invalid choice: 'eps' .*"),
    ("run level --figures x.pdf", r"--figures names a folder, not a file like 'x\.pdf'"),
    ("run level --html x.html --backend mock", r"--html shows a simulated machine; .* is mock"),
    ("report --out no/x.html", r"cannot write 'no/x\.html': the folder 'no' does not exist"),
    ("report --seeds 0", r"argument --seeds: must be a whole number of 1 or more, not '0' .*"),
    ("report --slow", r"unrecognized arguments: --slow .*"),
    # --- many seeds
    *(
        (
            f"run level --seeds 2 --{option} x",
            rf"--{option} shows a single run and does not go with --seeds",
        )
        for option in ("html", "log", "graphviz", "figures")
    ),
    ("study level --vary seed=0:2 --rows 5", r"runs of 'level' on multibody have no laws .*"),
    ("study level --vary seed=0:2 --rows x", r"argument --rows: must be auto, or a whole .*"),
    ("run level --seeds 2 --plot", r"--plot shows a single run and does not go with --seeds"),
    *(
        (f"run level --seeds={n}", rf"argument --seeds: must be a whole .*, not '{n}' .*")
        for n in ("0", "-1", "1.5", "many")
    ),
    ("run level --seeds 2 --backend hardware", r"--seeds runs simulations; .* is hardware"),
    # --- jobs of the platform that do not fit
    (
        f"run level --backend kinematic --set {_STEEP}",
        r"leg [13] would need an extension of .*, (0\.[5-9]|1\.[01])\d mm outside its stroke .*",
    ),
    ("run level --set job.end=20", r"job\.end = 20 s is not after the last waypoint, .* s"),
    ("run level --set job.end=26", r"job\.end = 26 s is not after the end of the arm's .* s"),
    (
        "run level --set job.settled_after=8",
        r"job\.waypoints\.0\.time = .* s is earlier than job\.settled_after = 8 s",
    ),
    (
        "run level --set job.waypoints.1.time=6.5",
        r"job\.waypoints\.1\.time = 6\.5 s is earlier than the waypoint before, .* s",
    ),
    (
        "run level --set plant.time_step=0.02",
        r"control\.period = 0\.01 s is below plant\.time_step = 0\.02 s",
    ),
    *(
        (f"run {job} --set control.period=0.001 plant.time_step=0.002", r"control\.period = .*")
        for job in ("deploy", "chair-walk", "chair-engines", "bench-walk")
    ),
    (
        "run uneven-ground --backend kinematic --set ground.foot_heights_mm=[50,-50,50,-50]",
        r"leg \d would need .*",
    ),
    ("draw workspace --out x.svg", r"the experiment 'workspace' has no closed loop of a machine"),
    ("draw level --out x.xyz", r"cannot write 'x\.xyz': a diagram's suffix must be one of .*"),
    ("draw level --depth 0 --out x.svg", r".*0.*"),
    (
        "export workspace --out x.urdf",
        r"the experiment 'workspace' simulates no bodies; .*level, .*",
    ),
    (
        "export level --out x.obj",
        r".* 'x\.obj': a machine's suffix must be one of \.urdf, \.sdf, .*",
    ),
    ("export level --out x --to sdf", r".* 'x': the suffix of SDFormat must be one of \.sdf"),
    ("export level --out x.urdf --to sdf", r".* the suffix of SDFormat must be one of \.sdf"),
    ("export level --to obj --out x.obj", r"argument --to: invalid choice: 'obj'.*"),
    ("export level --out no/x.urdf", r"cannot write 'no/x\.urdf': the folder 'no' does not exist"),
    (
        "export level --backend kinematic --out x.urdf",
        r"the backend 'kinematic' of the levelling platform simulates no plant of .*",
    ),
    ("run track-posture --set job.waypoints=[]", r"job\.waypoints is empty: no posture .*"),
    # --- operations
    *(
        (f"run deploy --backend kinematic --set drive.distance_m=0.05 work.hold_s=0.5 {key}", said)
        for key, said in (
            (
                "ground.roll_deg=5 ground.pitch_deg=6",
                r"leg [1-4] would need .* mm outside its stroke 390\.0\.\.420\.0 mm.*"
                r"stays in estimate",
            ),
            (
                "work.height_mm=570",
                r"leg [1-4] would need .* mm outside its stroke .*"
                r"height must be \d{3}\.\d\.\.\d{3}\.\d mm; the machine stays in estimate",
            ),
            # The operator asks for less before the operation ends, and that is not refused.
            (
                "work.arm_deg=100",
                r"the arm's move goes beyond .* arm -90 deg to 90 deg; the machine stays in hold",
            ),
            (
                "ground.foot_heights_mm=[0,-5,0,0]",
                r"ground\.foot_heights_mm must be 0 or more .*",
            ),
        )
    ),
    # --- faults
    (
        ["run", "deploy", "--set", "faults=[{kind: of}]"],
        rf"faults\.0\.kind = 'of' is not one of {_KINDS} \(did you mean off\?\)",
    ),
    (
        ["run", "deploy", "--set", "faults=[{target: legs.extensio}]"],
        r"faults\.0\.target = 'legs\.extensio' is not one of legs\.extension, imu\.gyro, "
        r"imu\.accel, legs\.limits, legs\.emergency_stop, legs\.voltage, supply, posture_command "
        r"\(did you mean legs\.extension\?\)",
    ),
    (
        ["run", "deploy", "--set", "faults=[{target: legs.extension, index: 4}]"],
        r"faults\.0\.index = 4 is outside -1\.\.3; legs\.extension has elements 0\.\.3, "
        r"-1 is all of them",
    ),
    # --- steps of the actuators, slip, calibration
    *(
        (f"run identify-actuators --set {override}", rf"{re.escape(key)} .*")
        for override, key in (
            ("steps.voltages=[1,-1,1,0,2,-2,1,-1,1,-1]", "steps.voltages.3"),
            ("steps.voltages=[0.75,2,1.25,-1.5,1.75,-2,2.25,-2.5,2.75,-3]", "steps.voltages.2"),
            ("steps.voltages=[0.75,-1,1.25,-1.5,1.75,-2,2.25,-2.5,2.75,-11]", "steps.voltages.9"),
            ("machine.actuators.supply_voltage=2.9", "steps.voltages.9"),
            ("steps.voltages=[1,-1,1,-1,1,-1,1,-1,1,-1]", "steps.voltages"),
        )
    ),
    (
        "run slip --set lift.height_mm=590",
        r"lift\.height_mm = 590 is out of reach: leg \d would need .* outside its stroke .*",
    ),
    ("run calibrate --set recording=nowhere.npz", r".*'nowhere\.npz'.*No such file.*"),
    ("run calibrate --set poses.count=2", r".*15 poses or more.*"),
    ("run calibrate --set ground.known=false", r".*the ground's roll.*"),
    (
        "run level --set machine.wheels.depth_mm=300",
        r"machine\.wheels\.depth_mm: its wheels touch .* 265 mm deep at most, not 300 mm",
    ),
    # --- the chair
    (
        "run chair-walk --set passenger.x_mm=100 passenger.y_mm=50",
        r"the .* support margin of -3\.4 mm.*first swing.*|.*first swing.*margin of -3\.4 mm.*",
    ),
    ("run chair-walk --set gait.lift_mm=110", rf"{_BRANCH} .*"),
    ("run chair-walk --set gait.phase_duration=4.6", r"branch \d\d would move at .* mm/s .*"),
    ("run chair-walk --set passenger.mass_kg=200", r".*427\.3 N.*"),
    ("run chair-walk --set control.support_margin_mm=60", r".*less than the 60\.0 mm.*"),
    ("run chair-gait --set gait.lift_mm=100", r"branch 12 would need a length of 561\..*"),
    ("run chair-gait --set gait.phase_duration=4", r"branch 12 would move at 93\.95\d mm/s .*"),
    ("run chair-gait --set gait.phase_duration=4.69", r"branch 12 would move at .*"),
    ("run chair-gait --set gait.step_mm=300", r"branch \d\d would need a length of .*"),
    ("run chair-payload --set gait.lift_mm=100", r"branch 12 would need a length of .*"),
    ("run chair-payload --set gait.phase_duration=4", r"branch 12 would move at .*"),
    ("run chair-gait --set gait.cycles=11", r".*cycles are all alike, and up to 10 are drawn.*"),
    ("run chair-circle --set circle.z_mm=-665.4", r"branch 1[23] would need .* 571\.13\d mm .*"),
    ("run chair-circle --set circle.lap_duration=3", r"branch 1[23] would move at 92\.9.*"),
    ("run chair-circle --set circle.radius_mm=300", rf"{_BRANCH} .*"),
    (
        "run chair-circle --set circle.laps=1 circle.ramp=6",
        r"circle\.ramp = 6 s is longer than all laps, 5 s",
    ),
    (
        "run chair-payload --set payload.x_mm=100 payload.y_mm=50",
        r"the .* less than the 10\.0 mm that are required.*",
    ),
    ("run chair-payload --set support_margin_mm=55", r".*54\.5 mm, less than the 55\.0 mm.*"),
    # --- measuring this computer
    *(
        (f"bench-rt --rates {rate}", rf"--rates {rate.split()[-1]} is outside 20\.\.1000 Hz")
        for rate in ("19", "100 1001", "-5", "nan")
    ),
    *(
        (f"bench-rt --seconds {time}", rf"--seconds {time} is outside 1\.\.3600")
        for time in ("0.9", "3601", "inf", "nan")
    ),
    ("bench-rt --json no/x.json", r"cannot write 'no/x\.json': the folder 'no' does not exist"),
    ("bench-rt --rates", r"argument --rates: expected at least one argument .*"),
    ("bench-rt --rates fast", r"argument --rates: invalid float value: 'fast' .*"),
    # The machine itself is never measured.
    ("bench-rt --backend multibody", r"argument --backend: invalid choice: 'multibody' .*"),
    ("bench-rt --of chair-circle", r"backend = 'mock' is not one of kinematic.*"),
    # --- devices, where no emulator runs
    (
        "emulate chair-circle",
        r"'chair-circle' has no machine that can be emulated; these have: .*level.*",
    ),
    ("emulate level --backend mock", r"backend = 'mock' cannot be behind emulated devices; .*"),
    *(
        (
            ["emulate", "level", "--backend", "kinematic", "--fault", fault],
            rf"'{fault}' .*{words}.*",
        )
        for fault, words in (
            ("12 imu nonsense", _KINDS),
            ("12 rudder off", "arm, imu, legs, wheels"),
            ("imu off", "a time in seconds"),
        )
    ),
    ("operate level", r"'level' has nothing that a person operates"),
    ("operate workspace", r"'workspace' has nothing that a person operates"),
    ("operate deploy --log x.mcap", r"--log is of hardware; the backend is multibody"),
    (
        "operate deploy --backend hardware",
        r"!NiDaqLegs\.target = .*/ni\.sock.*parapod emulate deploy.*",
    ),
    ("operate deploy --backend mock", r"backend = 'mock' is not one of multibody, .*"),
    (
        "operate chair-walk --host nowhere.invalid",
        r"no page can be served at 'nowhere\.invalid': .*",
    ),
    # --- logs
    ("replay none.npz", r"cannot read log 'none\.npz': No such file or directory"),
    ("plot none.mcap", r"cannot read log 'none\.mcap': No such file or directory"),
    ("replay none.npz --video a.gif --against b.npz", r"--against does not go with --video.*"),
    ("replay none.npz --video a.gif", r"cannot read log 'none\.npz': .*"),
    ("replay none.npz --html a --meshcat", r"argument --meshcat: not allowed with argument .*"),
    ("replay none.npz --html nowhere/a.html", r"cannot write 'nowhere/a\.html': the folder .*"),
    ("replay none.npz --between 2 1", r"--between 2 1: the end must be after the beginning"),
    ("plot none.npz --between 0 inf", r"argument --between: must be a finite number, not 'inf'.*"),
    ("plot none.npz --out a.bmp", r"cannot write 'a\.bmp': a figure's suffix must be one of .*"),
    ("run level --backend hardware", r"!NiDaqLegs\.target = .*/ni\.sock.*parapod emulate level.*"),
    ("check imu", r"!Adis16448SpiImu\.\w+ = .*/spi\.sock.*parapod emulate level.*"),
    ("check wheels", r"!Epos2Wheels\.channel = emulator/can.*parapod emulate level.*"),
    (
        "run chair-walk --backend hardware",
        r"!Epos2Legs\.channel = emulator/can, but no .*"
        r"begin `parapod emulate chair-walk` in another terminal.*",
    ),
    ("check rudder", r"part 'rudder' is not one of .*legs.*"),
    ("check imu --move 1 --yes", r".*'imu' cannot be moved; legs, wheels, arm can|!Adis.*"),
    ("check legs --seconds 0", r"--seconds 0 is outside 0\.1\.\.3600"),
]


@pytest.mark.parametrize(
    ("arguments", "words"),
    REFUSALS,
    ids=lambda value: (value if isinstance(value, str) else " ".join(value))[:40],
)
def test_a_mistake_is_one_line_exit_code_2_and_leaves_nothing(
    arguments, words, tmp_path, monkeypatch, capsys
):
    work, nowhere = tmp_path / "work", tmp_path / "emulator"
    work.mkdir()
    monkeypatch.chdir(work)
    monkeypatch.setenv("PARAPOD_EMULATOR", str(nowhere))
    assert main(arguments.split() if isinstance(arguments, str) else arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    line = err.removesuffix("\n")
    assert err == f"{line}\n"
    assert re.fullmatch(f"parapod: error: (?:{words})", line)
    assert line.isprintable()
    assert len(line) < 700
    assert list(work.iterdir()) == []
    assert not nowhere.exists() or list(Path(nowhere).iterdir()) == []


def test_what_a_killed_emulator_left_behind_is_no_emulator(tmp_path, monkeypatch, capsys):
    (tmp_path / "wires").write_bytes(bytes(1000))
    monkeypatch.setenv("PARAPOD_EMULATOR", str(tmp_path))
    assert main(["run", "level", "--backend", "hardware"]) == 2
    assert "but no emulator runs in" in capsys.readouterr().err
