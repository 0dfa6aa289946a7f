"""Run the tests under conditions of other computers, and show what each one found.

`make test-hard` runs all tests under all conditions, which takes hours. Some of both:

    make test-hard CONDITIONS="one-core user" ARGS="tests/systems tests/laws/test_refusals.py"

A condition that this computer does not permit is skipped with the reason. What the tests print
under a condition is in `build/hard/CONDITION.txt`. The exit code is 1 if any test failed.
"""

import argparse
import os
import pwd
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from run import OUTCOMES, read_report

ROOT = Path(__file__).resolve().parents[1]
SAID = ROOT / "build" / "hard"
NOT_COPIED = (".git", ".venv", "build", "dist", "out", "*.egg-info", "__pycache__", ".*_cache")
NOBODY = "nobody"
BUSY = 4  # programs that compute
SHM = "64m"


class NotPermitted(Exception):
    """A condition cannot be had on this computer; the reason."""


@dataclass
class Setting:
    """What the tests are started with.

    Attributes:
        prefix: words of the command before `make`.
        folder: where it runs.
        environment: variables that are set.
        options: options of pytest.
    """

    prefix: list[str] = field(default_factory=list)
    folder: Path = ROOT
    environment: dict[str, str] = field(default_factory=dict)
    options: str = ""


def need(program: str) -> str:
    """Path of a program.

    Raises:
        NotPermitted: it is not installed.
    """
    if (found := shutil.which(program)) is None:
        raise NotPermitted(f"there is no {program}")
    return found


def permitted(*command: str) -> None:
    """Try a command.

    Raises:
        NotPermitted: it fails.
    """
    need(command[0])
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip() or f"exit code {done.returncode}").splitlines()[-1]
        raise NotPermitted(f"{shlex.join(command[:2])}: {last}")


def after(script: str, argument: str = "sh") -> list[str]:
    """Words before a command that is run after lines of a shell, whose $0 is an argument."""
    return ["sh", "-c", f'set -e\n{script}\nexec "$@"', argument]


def remounted(script: str, argument: str = "sh") -> list[str]:
    """Words before a command that sees other mounts than everybody else; see `after`."""
    permitted("unshare", "--mount", "true")
    return ["unshare", "--mount", *after(script, argument)]


# Conditions


def one_core() -> Iterator[Setting]:
    """all programs on one core"""
    core = str(min(os.sched_getaffinity(0))) if hasattr(os, "sched_getaffinity") else "0"
    permitted("taskset", "-c", core, "true")
    yield Setting(["taskset", "-c", core])


def busy() -> Iterator[Setting]:
    """beside four programs that compute"""
    computing = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(BUSY)]
    try:
        yield Setting()
    finally:
        for program in computing:
            program.kill()
            program.wait()


def half_speed() -> Iterator[Setting]:
    """half the time of each core"""
    quota = 50_000 * (os.cpu_count() or 1)  # of each 100 ms [us]
    one, two = Path("/sys/fs/cgroup/cpu"), Path("/sys/fs/cgroup")
    name = f"parapod-hard-{os.getpid()}"
    try:
        if (one / "cpu.cfs_quota_us").exists():
            group = one / name
            group.mkdir()
            (group / "cpu.cfs_period_us").write_text("100000")
            (group / "cpu.cfs_quota_us").write_text(str(quota))
        else:
            (two / "cgroup.subtree_control").write_text("+cpu")
            group = two / name
            group.mkdir()
            (group / "cpu.max").write_text(f"{quota} 100000")
    except OSError as error:
        if not Path("/run/systemd/system").exists():
            raise NotPermitted(f"no control group, and no systemd: {error}") from error
        scope = ["systemd-run", "--scope", "--quiet", "-p", f"CPUQuota={quota // 1000}%", "--"]
        permitted(*scope, "true")
        yield Setting(scope)
        return
    try:
        yield Setting(after('echo $$ > "$0"', str(group / "cgroup.procs")))
    finally:
        end = time.monotonic() + 60.0
        while (group / "cgroup.procs").read_text() and time.monotonic() < end:
            time.sleep(0.1)
        group.rmdir()


def _random(seed: int):
    def condition() -> Iterator[Setting]:
        yield Setting(options=f"--random-order-bucket=module --random-order-seed={seed}")

    condition.__doc__ = f"in the random order of seed {seed}"
    return condition


def user() -> Iterator[Setting]:
    """as a user who owns nothing but a copy of the tree"""
    if os.geteuid() != 0:
        raise NotPermitted("only root can become another user, and you are none")
    become = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
    try:
        permitted(*become, "true")
    except NotPermitted:  # where the group has another name
        become[2] = "--regid=nogroup"
        permitted(*become, "true")
    with _copy("parapod") as folder:
        shutil.chown(folder.parent, NOBODY)
        home = folder.parent / "home"
        home.mkdir()
        owner = pwd.getpwnam(NOBODY).pw_uid
        for path in folder.parent.rglob("*"):
            os.chown(path, owner, -1, follow_symlinks=False)
        python = [str(folder / ".venv" / "bin" / "python"), "-c", "import numpy"]
        prefix = become
        try:
            permitted(*become, *python)
        except NotPermitted:  # Python is in the home of root, which nobody else may enter
            place = folder.parent / "shown"
            place.mkdir()
            prefix = _shown(place, sys.base_prefix, _site()) + become
            permitted(*prefix, *python)
        yield Setting(prefix, folder, {"HOME": str(home), "USER": NOBODY, "LOGNAME": NOBODY})


def _shown(place: Path, *paths: str | Path) -> list[str]:
    """Words before a command that may read folders though they are below a closed one.

    Args:
        place: an empty folder, for mounts.
        paths: the folders.
    """
    closed = {
        path: [p for p in Path(path).parents if not p.stat().st_mode & 0o001] for path in paths
    }
    hidden = {shlex.quote(str(path)): above[-1] for path, above in closed.items() if above}
    lines = ['mount -t tmpfs none "$0"']
    for number, path in enumerate(hidden):
        lines += [f'mkdir "$0"/{number}', f'mount --bind {path} "$0"/{number}']
    for above in set(hidden.values()):
        lines.append(f"mount -t tmpfs -o mode=755 none {shlex.quote(str(above))}")
    for number, path in enumerate(hidden):
        lines += [f"mkdir -p {path}", f'mount --bind "$0"/{number} {path}']
    return remounted("\n".join(lines), str(place))


def background() -> Iterator[Setting]:
    """in the background of a shell, where Ctrl-C is ignored"""
    yield Setting(after("trap '' INT"))


def environment() -> Iterator[Setting]:
    """HOME is read-only, the time zone and language are others"""
    with tempfile.TemporaryDirectory(prefix="home") as home:
        os.chmod(home, 0o555)
        prefix = []
        if os.geteuid() == 0:  # who may write all the same
            prefix = remounted('mount -t tmpfs -o ro,mode=555 none "$0"', home)
        yield Setting(
            prefix, environment={"HOME": home, "TZ": "Pacific/Kiritimati", "LC_ALL": "C"}
        )


def small_shm() -> Iterator[Setting]:
    """/dev/shm of 64 MiB"""
    yield Setting(remounted(f"mount -t tmpfs -o size={SHM} none /dev/shm"))


def space() -> Iterator[Setting]:
    """in a folder with spaces in its name"""
    with _copy("a tree of parapod") as folder:
        yield Setting(folder=folder)


def wheel() -> Iterator[Setting]:
    """parapod is installed from its wheel"""
    with _copy("parapod", is_wheel=True) as folder:
        yield Setting(folder=folder)


CONDITIONS = {
    "one-core": one_core,
    "busy": busy,
    "half-speed": half_speed,
    **{f"random-{seed}": _random(seed) for seed in (1, 2, 3)},
    "user": user,
    "background": background,
    "environment": environment,
    "small-shm": small_shm,
    "space": space,
    "wheel": wheel,
}


# Copies


def _site() -> Path:
    return Path(sysconfig.get_path("purelib"))


@contextmanager
def _copy(name: str, is_wheel: bool = False) -> Iterator[Path]:
    """A copy of the tree with an environment in which parapod is that copy, or its wheel.

    All other packages are those of this environment.
    """
    with tempfile.TemporaryDirectory(prefix="hard") as temporary:
        os.chmod(temporary, 0o755)
        folder = Path(temporary).resolve() / name
        shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*NOT_COPIED))
        environment = folder / ".venv"
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True)
        ours, python = _site(), environment / "bin" / "python"
        site = environment / ours.relative_to(sys.prefix)
        if is_wheel:
            _install_wheel(folder, python)
        else:
            for path in (*ours.glob("__editable__*parapod*"), *ours.glob("parapod-*.dist-info")):
                if path.is_dir():
                    shutil.copytree(path, site / path.name)
                else:
                    text = path.read_text().replace(str(ROOT), str(folder))
                    (site / path.name).write_text(text)
        (site / "others.pth").write_text(f"{ours}\n")  # after what is in this environment
        programs = {
            "pytest": "-m pytest",
            "parapod": '-c "import sys; from parapod.sims.cli.main import main; sys.exit(main())"',
        }
        for program, words in programs.items():
            path = environment / "bin" / program
            path.write_text(f'#!/bin/sh\nexec {shlex.quote(str(python))} -P {words} "$@"\n')
            path.chmod(0o755)
        (environment / ".installed").touch()
        where = "import parapod; print(parapod.__file__)"
        told = subprocess.check_output([python, "-P", "-c", where], text=True, cwd=temporary)
        expected = site / "parapod" if is_wheel else folder
        assert Path(told.strip()).resolve().parent == expected.resolve(), told
        yield folder


def _install_wheel(folder: Path, python: Path) -> None:
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    with tempfile.TemporaryDirectory() as built:
        tree = Path(built) / "tree"
        shutil.copytree(folder, tree, ignore=shutil.ignore_patterns(*NOT_COPIED))
        options = ["--no-deps", "--no-build-isolation", "--wheel-dir", built]
        subprocess.run([*pip, "wheel", *options, tree], check=True)
        (file,) = Path(built).glob("*.whl")
        subprocess.run([*pip, "--python", python, "install", "--no-deps", file], check=True)


# Runs


@dataclass
class Found:
    """What the tests under one condition found.

    Attributes:
        state: `ok`, `FAILED`, or why the condition was skipped.
        took: duration [s].
        tests: outcome and duration [s] by node id.
    """

    state: str
    took: float = 0.0
    tests: dict[str, tuple[str, float]] = field(default_factory=dict)


def run(name: str, tests: str) -> Found:
    """Run tests under a condition.

    Args:
        name: one of `CONDITIONS`.
        tests: arguments of pytest.
    """
    with ExitStack() as stack:
        try:
            setting = stack.enter_context(contextmanager(CONDITIONS[name])())
        except NotPermitted as error:
            return Found(f"skipped: {error}")
        said = stack.enter_context((SAID / f"{name}.txt").open("w"))
        kept = {key: value for key, value in os.environ.items() if not key.startswith("MAKE")}
        given = kept | setting.environment | {"PYTEST_ADDOPTS": setting.options}
        begun = time.monotonic()
        for report in (setting.folder / "build" / "tests").glob("*.xml"):
            report.unlink()
        code = subprocess.run(
            [*setting.prefix, "make", "--no-print-directory", "tests", f"ARGS={tests}"],
            cwd=setting.folder,
            env=given,
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
            check=False,
        ).returncode
        found = Found("FAILED" if code else "ok", time.monotonic() - begun)
        for report in (setting.folder / "build" / "tests").glob("*.xml"):
            found.tests |= read_report(report) or {}
        return found


def main() -> int:
    """Run the conditions that are named, and show what each found; returns the exit code."""
    listed = "\n".join(f"  {name:<12} {made.__doc__}" for name, made in CONDITIONS.items())
    parser = argparse.ArgumentParser(
        description=f"{__doc__}\nconditions:\n{listed}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("conditions", nargs="*", metavar="condition", help="default: all")
    names = parser.parse_args().conditions or list(CONDITIONS)
    if unknown := sorted(set(names) - set(CONDITIONS)):
        parser.error(f"{', '.join(unknown)}: not one of {', '.join(CONDITIONS)}")
    tests = os.environ.get("ARGS", "")
    SAID.mkdir(parents=True, exist_ok=True)
    results = {}
    for name in names:
        print(f"{name}: {CONDITIONS[name].__doc__} ...", flush=True)
        results[name] = run(name, tests)
    print(f"\n{'condition':<12}" + "".join(f"{name:>8}" for name in OUTCOMES) + f"{'time':>8}")
    for name, found in results.items():
        counts = Counter(outcome for outcome, _ in found.tests.values())
        numbers = "".join(f"{counts[outcome]:>8}" for outcome in OUTCOMES)
        took = "" if found.state.startswith("skipped") else f"{found.took:>6.0f} s"
        print(f"{name:<12}" + (f"{numbers}{took}  {found.state}" if took else found.state))
    for name, found in results.items():
        if found.state == "FAILED":
            print(f"FAILED {name}: see {(SAID / name).relative_to(ROOT)}.txt")
            for test, (outcome, _) in sorted(found.tests.items()):
                if outcome == "failed":
                    print(f"  {test}")
    return int(any(found.state == "FAILED" for found in results.values()))


if __name__ == "__main__":
    sys.exit(main())
