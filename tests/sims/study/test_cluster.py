"""Studies on a Dask cluster of other processes."""

import json
import os
import signal
import subprocess
import sys

import pytest

from parapod.sims.cli.main import main
from parapod.sims.lab.work import NoWorkers
from parapod.sims.study import cluster as cluster_module
from parapod.sims.study.cluster import ClusterCrew
from tests.sims.study.conftest import carry_out

CLUSTER = """
import json, sys, time
import dask
from distributed import LocalCluster
if __name__ == "__main__":
    # Where it takes longer until a worker has begun in place of one that has died, none does.
    limits = ("comm.timeouts.connect", "comm.timeouts.tcp", "deploy.lost-worker-timeout")
    dask.config.set({f"distributed.{name}": "600s" for name in limits})
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()]
        print(json.dumps([cluster.scheduler_address, pids]), flush=True)
        sys.stdin.read()
"""
VARY = {"x": "-2:2:6", "y": "-2:2:4", "wait": "0.05"}


@pytest.fixture
def cluster(trial, tmp_path, monkeypatch):
    """Address and process of a cluster with two workers, which begins within some seconds."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path[:1]))
    program = tmp_path / "cluster.py"
    program.write_text(CLUSTER)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([sys.executable, str(program)], text=True, **pipes) as process:
        address, workers = json.loads(process.stdout.readline())
        yield address, workers, process
        process.kill()


def test_a_cluster_one_of_whose_workers_is_killed_gives_the_rows_of_one_process(
    study, cluster, work
):
    address, workers, process = cluster
    whole = carry_out(study(VARY))
    with ClusterCrew(address) as crew:
        assert crew.size == 2
        submit, killed = crew.executor.submit, []

        def kill_one(*arguments):
            if not killed and len(killed_after()) > 4:
                killed.append(workers[0])
                os.kill(workers[0], signal.SIGKILL)
            return submit(*arguments)

        def killed_after():
            return (work / "a.parquet.journal").read_bytes().split(b'{"run"')

        crew.executor.submit = kill_one
        result = carry_out(study(VARY), work / "a.parquet", crew=crew)
    assert killed
    assert result.table.equals(whole.table, check_metadata=True)

    # A run that kills whoever carries it out fails alone, whichever worker is tried.
    with ClusterCrew(address) as crew:
        crew._client.run_on_scheduler(allow_no_failure)
        lethal = carry_out(study({"kind": "lethal,good", "x": "1:2:2"}), crew=crew)
        crew._client.wait_for_workers(2, timeout=300)
    assert all(
        text.startswith("the process that carried it out died") for text in lethal["error"][:2]
    )
    assert lethal["total_mm"][2:].tolist() == [1.0, 2.0]

    # The scheduler ends in the midst of another one.
    with ClusterCrew(address) as crew:
        submit = crew.executor.submit

        def end(*arguments):
            if len((work / "b.parquet.journal").read_bytes().split(b'{"run"')) > 4:
                process.kill()
            return submit(*arguments)

        crew.executor.submit = end
        with pytest.raises(NoWorkers):
            carry_out(study(VARY), work / "b.parquet", crew=crew)
    result = carry_out(study(VARY), work / "b.parquet", resume=True)
    assert result.table.equals(whole.table, check_metadata=True)


def allow_no_failure(dask_scheduler):
    dask_scheduler.allowed_failures = 0


allow_no_failure.__module__ = "__main__"  # so that it is sent as it is


def test_a_scheduler_that_is_not_there_is_named_in_one_line(trial, work, capsys, monkeypatch):
    monkeypatch.setattr(cluster_module, "_TIMEOUT", 1.0)
    arguments = ["study", "trial", "--vary", "x=0:1:2", "--out", "a.parquet"]
    for address, words in (
        ("tcp://127.0.0.1:9", "no scheduler answers at 'tcp://127.0.0.1:9'"),
        ("nonsense://", "no scheduler answers at 'nonsense://'"),
    ):
        assert main([*arguments, "--cluster", address]) == 2
        said = capsys.readouterr().err
        assert said.startswith(f"parapod: error: {words}")
        assert said.count("\n") == 1
    assert list(work.iterdir()) == []
