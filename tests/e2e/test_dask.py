"""A Dask cluster of separate processes on loopback: the same bits as one process, whatever becomes
of a worker.
"""

import logging
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pandas as pd
import pytest

import aoabench
from aoabench.cli.main import main
from aoabench.config.compose import compose_cells
from aoabench.engine import dask as dask_module
from aoabench.engine import runner
from aoabench.store import reach
from aoabench.store.keys import RunKeys
from aoabench.store.parts import intact_parts
from tests.commands import PATIENCE_S, Command

pytest.importorskip("distributed", reason="Dask is not installed: pip install 'aoabench[dask]'")

WORDS = [
    "noise=vmf",
    "filter=[pf_vmf,ekf_vmf]",
    "filter.pf_vmf.particles=20000",
    "reps=160",
    "runner.chunk=2",
]


def dask(name, *words, cwd):
    with (cwd / f"{name}.log").open("w") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *words], cwd=cwd, stdout=log, stderr=log
        )


@contextmanager
def cluster(folder):
    """A scheduler and two workers with a thread each, in a folder that is not the run's; address
    and workers.
    """
    started = [
        dask(
            "scheduler",
            "scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
            cwd=folder,
        )
    ]
    try:
        deadline = time.monotonic() + PATIENCE_S
        while not (
            found := re.search(
                r"Scheduler at:\s+(tcp://\S+)", (folder / "scheduler.log").read_text()
            )
        ):
            assert time.monotonic() < deadline, "no scheduler"
            time.sleep(0.05)
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")
        started += [dask(f"worker{i}", "worker", found[1], *options, cwd=folder) for i in range(2)]
        yield found[1], started[1:]
    finally:
        for process in started:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_rows_are_those_of_one_process_though_a_worker_is_killed_half_way(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    runner.run(compose_cells([*WORDS, "runner.n_jobs=1", "runner.out=here"]), progress=False)
    with cluster(tmp_path / "elsewhere") as (address, workers):
        words = ["runner=dask", f"runner.address={address}", "runner.out=dask"]
        command = Command(*WORDS, *words)
        deadline = time.monotonic() + PATIENCE_S
        for parts in (5, 15):
            while len(list(tmp_path.glob("dask/parts/*/*.json"))) < parts and command.running():
                assert time.monotonic() < deadline
                time.sleep(0.01)
            # first stopped: the run cannot end before the kill, which leaves unfinished tasks
            workers[0].send_signal(signal.SIGSTOP if parts == 5 else signal.SIGKILL)
        status, said = command.finished()
        assert status == 0, said
        for name in ("replications", "summary", "failures"):
            a, b = (pd.read_parquet(f"{out}/{name}.parquet") for out in ("dask", "here"))
            pd.testing.assert_frame_equal(a, b, check_exact=True)
        for folder in (tmp_path / "dask" / "parts").iterdir():
            parts = intact_parts(tmp_path / "dask", folder.name)
            assert sum(part.stop - part.start for part in parts) == 160
        # the same folder goes on with another backend, and a plug-in beside the run is found by the
        # workers
        more = runner.run(
            compose_cells([*WORDS, "reps=170", "runner.out=dask", "runner.n_jobs=1"]),
            progress=False,
        )
        assert more.computed == 20
        (tmp_path / "my_remote_origin.py").write_text(
            "from dataclasses import dataclass\nimport numpy as np\nfrom aoabench import Estimates\n\n\n@dataclass(frozen=True)\nclass Origin:\n"
            "    def __call__(self, batch, scenario, streams):\n        shape = batch.azimuth.shape[:2]\n"
            "        return Estimates(np.zeros((*shape, 3)), None, None, np.zeros(shape, dtype=np.int8))\n"
        )
        (tmp_path / "conf" / "estimator").mkdir(parents=True)
        (tmp_path / "conf" / "estimator" / "origin.yaml").write_text(
            "origin: {_target_: my_remote_origin.Origin}\n"
        )
        words += ["estimator=[origin]", "reps=300", "runner.chunk=128"]
        frame = aoabench.run(*words, out="plugin", config_dir="conf", plugins=["my_remote_origin"])
        assert len(frame) == 300
        # a worker with other code refuses to compute under this run's keys
        monkeypatch.setattr(reach, "version", lambda name: "0.1")
        with pytest.raises(aoabench.RunError, match="has another version of numpy than this run"):
            runner.run(
                compose_cells([*WORDS, "seed=2", *words[:2], "runner.out=dask"]), progress=False
            )


@pytest.mark.parametrize("preset", ["dask", "slurm"])
def test_the_presets_compose(preset, monkeypatch):
    given = compose_cells(
        ["filter=[ekf_vmf]", f"runner={preset}", "runner.address=tcp://node-1.cluster:8786"]
    )[0].runner
    assert (given.backend, given.address) == ("dask", "tcp://node-1.cluster:8786")
    monkeypatch.setenv("DASK_SCHEDULER_ADDRESS", "tls://10.0.0.1:8786")
    assert (
        compose_cells(["filter=[ekf_vmf]", f"runner={preset}"])[0].runner.address
        == "tls://10.0.0.1:8786"
    )


def test_the_cluster_is_not_part_of_any_key():
    local, far = (
        compose_cells(["filter=[ekf_vmf]", *more])[0]
        for more in (
            [],
            [
                "runner=slurm",
                "runner.address=tcp://a:1",
                "runner.max_failed=0",
                "until.metric=nees",
                "until.se=1",
            ],
        )
    )
    assert local.id == far.id
    assert RunKeys.of([local]).parts == RunKeys.of([far]).parts


@pytest.mark.parametrize(("words", "expected"), [
    (["runner.backend=dask"], ["runner.address", "tcp://HOST:PORT"]),
    (["runner.backend=dask", "runner.address=here"], ["runner.address", "here", "tcp://HOST:PORT"]),
    (["runner.backend=dask", "runner.address=inproc://x"], ["runner.address", "tcp://HOST:PORT"]),
    (["runner.address=tcp://127.0.0.1:1"], ["runner.address", "runner.backend=dask"]),
    (["runner=dask", "runner.address=tcp://127.0.0.1:1"], ["runner.address='tcp://127.0.0.1:1'", "no scheduler answers"]),
])  # fmt: skip
def test_a_bad_address_is_the_users_mistake(words, expected, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("aoabench.engine.dask._CONNECT_S", 1)
    with pytest.raises(SystemExit) as stop:
        main(["run", "filter=[ekf_vmf]", "reps=3", *words])
    said = capsys.readouterr().err
    assert stop.value.code == 2, said
    assert "Traceback" not in said
    for word in expected:
        assert word in said


# --- encrypted connections ------------------------------------------------------------------------


def certificate(folder, name):
    """A certificate that signs itself, and its key, as files in PEM; their paths."""
    folder.mkdir(exist_ok=True)
    paths = [str(folder / f"{name}.{end}") for end in ("crt", "key")]
    words = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1",
             "-nodes", "-days", "36500", "-subj", f"/CN={name}", "-out", paths[0], "-keyout", paths[1]]  # fmt: skip
    subprocess.run(words, check=True, capture_output=True)
    return paths


def tls_words(paths):
    return [f"runner.{name}={file}" for name, file in zip(TLS, (paths[0], *paths))]


TLS = ("tls_ca_file", "tls_cert", "tls_key")


@pytest.fixture(scope="module")
def secured(tmp_path_factory):
    """The words that name a scheduler that wants certificates, and those of a stranger's files."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl")
    from distributed import LocalCluster
    from distributed.security import Security

    folder = tmp_path_factory.mktemp("tls")
    own, other = (certificate(folder, name) for name in ("own", "other"))
    sides = {f"tls_{side}_{end}": file for side in ("scheduler", "worker", "client") for end, file in zip(("cert", "key"), own)}  # fmt: skip
    security = Security(require_encryption=True, tls_ca_file=own[0], **sides)
    options = {"processes": False, "n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}  # fmt: skip
    with LocalCluster(protocol="tls://", host="127.0.0.1", security=security, **options) as cluster:
        yield [f"runner.address={cluster.scheduler_address}"], own, other


SMALL = ["runner=dask", "estimator=[ls]", "scenario.steps=2", "reps=4", "runner.chunk=1"]


def test_a_run_on_an_encrypted_cluster(secured, tmp_path):
    address, own, _ = secured
    assert address[0].startswith("runner.address=tls://127.0.0.1:")
    far = aoabench.run(*SMALL, *address, *tls_words(own), out=tmp_path / "far")
    near = aoabench.run(*SMALL[1:], "runner.n_jobs=1", out=tmp_path / "near")
    pd.testing.assert_frame_equal(far, near, check_exact=True)


def test_a_cluster_without_workers_is_reported_each_time(monkeypatch, capsys):
    monkeypatch.setattr(dask_module, "_LOOK_S", 0)
    looks = iter([{"a": 1}, {}, {}, {"b": 1}, {}])

    class Client:
        def nthreads(self):
            return next(looks)  # at last StopIteration, as of a lost connection

    dask_module._watch(Client(), threading.Event())
    line = "aoabench: no worker is connected to the cluster any more: waiting for one ...\n"
    assert capsys.readouterr().err == 2 * line


def test_dasks_own_remarks_are_kept_off_the_terminal():
    logger, handler = logging.getLogger("distributed"), logging.StreamHandler()
    record = logger.makeRecord("distributed.client", logging.ERROR, "", 0, "lost", (), None)
    logger.addHandler(handler)  # as Dask does, unless the process has handlers of its own
    try:
        with dask_module._quiet():
            assert not handler.filter(record)
        assert handler.filter(record)
    finally:
        logger.removeHandler(handler)


def test_a_stranger_is_refused_by_the_cluster(secured, tmp_path, monkeypatch):
    address, _, other = secured
    monkeypatch.setattr("aoabench.engine.dask._CONNECT_S", 1)
    with pytest.raises(aoabench.UserError, match="no scheduler answers at this address"):
        aoabench.run(*SMALL, *address, *tls_words(other), out=tmp_path)
    assert not list(tmp_path.glob("parts/*"))


def test_without_files_an_encrypted_address_is_refused_or_dasks_own(secured, tmp_path):
    address, own, _ = secured
    with pytest.raises(aoabench.UserError, match=r"needs runner\.tls_ca_file, .* Dask's own conf"):
        aoabench.run(*SMALL, *address, out=tmp_path)
    import dask.config

    tls = {"ca-file": own[0], "client.cert": own[0], "client.key": own[1]}
    with dask.config.set({f"distributed.comm.tls.{key}": value for key, value in tls.items()}):
        assert len(aoabench.run(*SMALL, *address, out=tmp_path)) == 4


@pytest.mark.parametrize(("change", "expected"), [
    ({"tls_key": None}, ["runner.tls_key=None", "tls_ca_file, tls_cert, tls_key go together"]),
    ({"tls_cert": "nowhere.pem"}, ["runner.tls_cert='nowhere.pem'", "a file in PEM that can be read"]),
    ({"tls_ca_file": "."}, ["runner.tls_ca_file='.'", "a file in PEM"]),
    ({"tls_ca_file": 3}, ["runner.tls_ca_file=3", "a file in PEM"]),
    ({"address": "tcp://127.0.0.1:1"}, ["runner.address='tcp://127.0.0.1:1'", "tls://HOST:PORT"]),
    ({"tls_key": "garbage"}, ["runner.tls_key", "cannot be used"]),
    ({"tls_key": "locked"}, ["runner.tls_key=", "without a passphrase"]),
])  # fmt: skip
def test_files_that_do_not_do_are_the_users_mistake(change, expected, tmp_path, monkeypatch, capsys):  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "garbage").write_text("what?")
    (tmp_path / "locked").write_text("-----BEGIN ENCRYPTED PRIVATE KEY-----")
    given = {"address": "tls://127.0.0.1:1", **dict.fromkeys(TLS, "garbage"), **change}
    words = [f"runner.{name}={'null' if value is None else value}" for name, value in given.items()]
    with pytest.raises(SystemExit) as stop:
        main(["run", *SMALL, *words])
    said = capsys.readouterr().err
    assert (stop.value.code, len(said.splitlines())) == (2, 1), said
    for word in expected:
        assert word in said


def test_a_config_cannot_name_files_of_tls(tmp_path, monkeypatch):
    """Else it could make a run present the user's certificate to another's scheduler."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "key.pem").touch()
    (tmp_path / "c" / "runner").mkdir(parents=True)
    (tmp_path / "c" / "runner" / "mine.yaml").write_text(
        "defaults: [dask]\n" + "".join(f"{name}: key.pem\n" for name in TLS)
    )
    words = ["runner=mine", "estimator=[ls]", "runner.address=tls://a:1"]
    with pytest.raises(aoabench.UserError, match=r"runner\.tls_ca_file='key\.pem' is not allowed"):
        compose_cells(words, config_dir="c")
    assert compose_cells([*words, *(f"runner.{name}=key.pem" for name in TLS)], config_dir="c")
