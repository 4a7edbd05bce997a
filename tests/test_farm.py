"""`--ray`: shots and clips on a Ray cluster of two workers, one of which is killed at work; and what can be wrong."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from farm_jobs import set_threads, work
from synthetic import make_frames, write_sequence

from rtdenoise.cli.main import main
from rtdenoise.errors import InputError
from rtdenoise.render.clips import render_clips
from rtdenoise.render.options import ClipOptions
from rtdenoise.run.farm import Farm

ROOT = Path(__file__).parent.parent
TINY = ClipOptions(count=5, size=(32, 32), frames=2, seed=5, reference_range=(2, 4), workers=1)


@pytest.fixture(scope="module")
def cluster():
    """HOST:PORT of a cluster of two machines with one core each, both of them this one; one claims to have a GPU."""
    address = f"127.0.0.1:{_free_port()}"
    with tempfile.TemporaryDirectory(prefix="ray-", dir="/tmp") as folder:  # short: sockets have short paths
        head = ("--head", "--port", address.partition(":")[2], "--temp-dir", folder, "--include-dashboard=false",
                "--ray-client-server-port", str(_free_port()))  # fmt: skip
        nodes = [_start(*head, folder=folder)]
        try:
            _wait(lambda: _started(folder) == 1)
            nodes.append(_start("--address", address, "--num-gpus=1", folder=folder))
            _wait(lambda: _started(folder) == 2)
            yield address
        finally:
            for node in reversed(nodes):
                node.terminate()
                node.wait(30)


def _start(*words, folder):
    """A machine of a cluster."""
    command = (sys.executable, "-m", "ray.scripts.scripts", "start", "--num-cpus=1", "--block", "--node-ip-address",
               "127.0.0.1", "--object-store-memory=80000000", *words)  # fmt: skip
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}", "PYTHONUNBUFFERED": "1",
                                "RAY_USAGE_STATS_ENABLED": "0", "OMP_WAIT_POLICY": "passive"}  # fmt: skip
    log = open(Path(folder) / f"{time.monotonic_ns()}.log", "wb")  # noqa: SIM115 (the process holds it)
    return subprocess.Popen(command, env=environment, stdout=log, stderr=log)


def _free_port():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


def _started(folder):
    """How many machines say that they are ready."""
    return sum(b"Ray runtime started" in path.read_bytes() for path in Path(folder).glob("*.log"))


def _wait(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_killed_worker_costs_what_it_was_at(cluster, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    begun = tmp_path / "0-1.begun"

    def kill():
        _wait(lambda: begun.exists() and begun.read_text())
        begun.rename(tmp_path / "killed")
        os.kill(int((tmp_path / "killed").read_text()), signal.SIGKILL)

    threading.Thread(target=kill, daemon=True).start()
    jobs = [(tmp_path, number) for number in range(3)]
    results = list(Farm(cluster, tmp_path, threads=4).run(work, jobs, set_threads, "killed"))
    assert sorted(job[1] for job, _ in results) == [0, 1, 2]
    assert {result for _, result in results} == {("1", str(tmp_path))}  # of four cores as many as a machine has
    killed, again = ((tmp_path / name).read_text() for name in ("killed", "0-1"))
    assert (tmp_path / "0-0").read_text() == killed != again  # its first piece is kept, its second done by another


def test_what_ends_a_run(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr("rtdenoise.run.farm.ATTEMPTS", 1)
    with pytest.raises(ZeroDivisionError):
        list(Farm(cluster, tmp_path).run(divmod, [(1, 0)], set_threads, "killed"))
    with pytest.raises(InputError, match=r"killed .WorkerCrashedError, 1 times"):
        list(Farm(cluster, tmp_path).run(os._exit, [(1,)], set_threads, "killed"))


def test_a_job_gets_a_gpu_where_there_is_one(cluster, tmp_path):
    for gpu, visible in ((True, "0"), (False, None)):
        farm = Farm(cluster, tmp_path, gpu=gpu)
        assert [r for _, r in farm.run(os.getenv, [("CUDA_VISIBLE_DEVICES",)], set_threads, "killed")] == [visible]


def test_clips_and_shots(cluster, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    card = render_clips(Path("farm"), replace(TINY, ray=cluster), lambda *_: None)
    assert card["clips"] == 5
    for name in "ab":
        write_sequence(tmp_path / "shots" / name, make_frames(2))
    main(["denoise", "shots/*", "--out", "out", "--model", "fast", "--ray", cluster])
    said = capsys.readouterr().out
    assert "out/a: 2 frames written" in said and "out/b: 2 frames written" in said


def test_machines_that_do_not_see_the_folder(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr("rtdenoise.run.farm.secrets.token_hex", lambda n: "x/../x")  # so that nobody finds the file
    monkeypatch.setattr(Path, "touch", lambda self: None)
    with pytest.raises(InputError, match=r"machine \S+ \(\S+\) does not see .*out; expected a folder that all"):
        list(Farm(cluster, tmp_path / "out").run(len, [("",)], set_threads, "killed"))


@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_an_address_that_does_not_answer(tmp_path, capsys, monkeypatch, scheme):
    monkeypatch.setattr("rtdenoise.run.farm.CONNECT", 1.0)
    address = f"{scheme}127.0.0.1:{_free_port()}"
    with pytest.raises(SystemExit) as stop:
        main(["clips", "--count", "1", "--size", "32", "--out", str(tmp_path), "--ray", address])
    assert stop.value.code == 2
    assert f"--ray {address}: no Ray cluster answers there" in capsys.readouterr().err


def test_no_ray(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    for name in "ab":
        (tmp_path / "shots" / name).mkdir(parents=True)
    for words in (["clips", "--count", "1", "--size", "32"], ["denoise", str(tmp_path / "shots" / "*")]):
        with pytest.raises(SystemExit):
            main([*words, "--out", str(tmp_path / "out"), "--ray", "auto"])
        assert "ray is not installed; type: pip install 'rtdenoise[farm]'" in capsys.readouterr().err


def test_options_that_do_not_go_together(tmp_path, capsys):
    for words, complaint in (
        (["clips", "--workers", "3"], "--workers: is for processes of this machine"),
        (["denoise", "a", "b", "--workers", "3"], "--workers: is for processes of this machine"),
        (["denoise", str(tmp_path)], "a sequence is one; name several"),
    ):
        with pytest.raises(SystemExit):
            main([*words, "--out", str(tmp_path / "out"), "--ray", "auto"])
        assert complaint in capsys.readouterr().err
