"""A search on a local Ray cluster: the same trials as the local pool, and nothing lost when something dies."""

import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from slipangle.errors import ConfigError
from slipangle.identify.search.search import Range, Search

pytestmark = pytest.mark.slow
SPACE = {"x": Range(low=-2.0, high=3.0), "n": Range(low=1, high=9)}


@dataclass(frozen=True)
class Hill:
    """Takes a while; kills its worker once, at one trial, if told where to leave the mark."""

    seconds: float = 0.05
    fatal: int = -1
    mark: str = ""

    def __call__(self, settings, seed, report):
        if seed == self.fatal and not os.path.exists(self.mark):
            Path(self.mark).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        for k in (2, 1):
            time.sleep(self.seconds / 2)
            report(k * ((settings["x"] - 0.7) ** 2 + abs(settings["n"] - 4)))
        return (settings["x"] - 0.7) ** 2 + abs(settings["n"] - 4) + 1e-9 * seed


def study(**options):
    return Search(**{"space": SPACE, "trials": 64, "workers": 2, **options})


def plain(result):
    return [(t.number, t.settings, t.score, t.failure) for t in result.trials]


def ray_command(*words):
    path = Path(sys.executable).with_name("ray")
    return subprocess.run([str(path), *words], capture_output=True, text=True, check=False, timeout=120)


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Here:
    """A head with two processors on this machine, in processes of its own."""

    def __init__(self, folder):
        self.folder, self.port = folder, free_port()

    def start(self):
        small = ("--num-cpus=2", "--object-store-memory=100000000", "--include-dashboard=false")
        where = ("--node-ip-address=127.0.0.1", f"--port={self.port}", f"--temp-dir={self.folder}")
        root = str(Path(__file__).parents[2])
        before = os.environ.get("PYTHONPATH")
        os.environ["PYTHONPATH"] = root  # workers import the objective from the tests
        done = ray_command("start", "--head", *small, *where)
        os.environ.pop("PYTHONPATH") if before is None else os.environ.update(PYTHONPATH=before)
        assert done.returncode == 0, done.stderr
        return f"127.0.0.1:{self.port}"

    def pids(self):
        found = []
        for entry in Path("/proc").iterdir():
            try:
                line = (entry / "cmdline").read_bytes() if entry.name.isdigit() else b""
            except OSError:
                continue
            if str(self.folder).encode() in line:
                found.append(int(entry.name))
        return found

    def kill(self):
        for pid in self.pids():
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                pass


@pytest.fixture
def cluster(monkeypatch):
    pytest.importorskip("ray")
    pytest.importorskip("optuna")
    folder = Path(f"/tmp/slipangle-ray-{os.getpid()}-{time.monotonic_ns() % 10**6}")  # short: sockets live there
    monkeypatch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    here = Here(folder)
    yield here
    here.kill()


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_gives_the_trials_of_the_local_pool_and_a_killed_worker_loses_nothing(cluster, tmp_path):
    address = cluster.start()
    local = study().run(Hill())
    spread = study(cluster=address).run(Hill())
    assert plain(spread) == plain(local)
    assert spread.best.score == local.best.score
    assert local.pruned
    mark = tmp_path / "killed"
    wounded = study(cluster=address).run(Hill(fatal=21, mark=str(mark)))
    assert mark.exists()
    assert plain(wounded) == plain(local)


@pytest.mark.filterwarnings("ignore")
def test_a_study_survives_the_end_of_the_cluster_and_of_the_driver(cluster, tmp_path):
    whole = study(trials=24).run(Hill(seconds=0.0))
    journal = tmp_path / "journal"
    address = cluster.start()
    driver = subprocess.Popen([sys.executable, "-c", DRIVER, str(journal), address], env=surroundings())
    wait_for_trials(journal, 5)
    driver.send_signal(signal.SIGKILL)  # first the driver
    driver.wait()
    kept = finished(journal)
    assert 5 <= kept < 24
    driver = subprocess.Popen([sys.executable, "-c", DRIVER, str(journal), address], env=surroundings())
    wait_for_trials(journal, kept + 3)
    cluster.kill()  # then the cluster
    driver.wait(timeout=180)
    assert driver.returncode != 0
    assert finished(journal) >= kept + 3
    told = []
    rest = study(trials=24, journal=journal, cluster=cluster.start()).run(
        Hill(), progress=lambda share, what: told.append(what)
    )
    assert plain(rest) == plain(whole)
    assert 0 < len(told) <= 24 - kept - 3


@pytest.mark.filterwarnings("ignore")
def test_no_cluster_is_a_sentence(cluster):
    with pytest.raises(ConfigError, match="ray start --head"):
        study(cluster=f"127.0.0.1:{free_port()}").run(Hill())


DRIVER = """
import sys
from tests.identify.search.test_search_cluster import Hill, study
study(trials=24, journal=sys.argv[1], cluster=sys.argv[2]).run(Hill(seconds=1.0))
"""


def surroundings():
    return {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}


def finished(journal):
    """Trials kept in a journal, read as a resumed study reads them."""
    search = study(trials=24, journal=journal)
    import optuna

    return len(search._told(search._study(optuna)))


def wait_for_trials(journal, count, seconds=180.0):
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if journal.exists() and finished(journal) >= count:
            return
        time.sleep(0.5)
    raise AssertionError(f"{finished(journal)} trials after {seconds} s")
