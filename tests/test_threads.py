"""Threads wait passively and keep to a container's share, without anybody having to know."""

import os
import subprocess
import sys

import pytest

from rtdenoise.run import threads


@pytest.fixture
def fresh(monkeypatch):
    """No torch, nothing set, no limit."""
    monkeypatch.delitem(sys.modules, "torch")
    monkeypatch.setattr(threads, "cpu_limit", lambda: None)
    for name in ("OMP_WAIT_POLICY", "OMP_NUM_THREADS"):
        monkeypatch.setenv(name, "")  # so that what the code sets is undone after the test
        monkeypatch.delenv(name)
    return monkeypatch


def test_threads_wait_passively(fresh):
    threads.set_defaults()
    assert os.environ["OMP_WAIT_POLICY"] == "passive" and "OMP_NUM_THREADS" not in os.environ


def test_threads_keep_to_the_limit_of_a_container(fresh):
    fresh.setattr(threads, "cpu_limit", lambda: 3)
    fresh.setattr(os, "cpu_count", lambda: 64)
    threads.set_defaults()
    assert os.environ["OMP_NUM_THREADS"] == "3"


def test_the_users_own_settings_stay(fresh):
    fresh.setenv("OMP_WAIT_POLICY", "active")
    fresh.setenv("OMP_NUM_THREADS", "7")
    fresh.setattr(threads, "cpu_limit", lambda: 1)
    threads.set_defaults()
    assert os.environ["OMP_WAIT_POLICY"] == "active" and os.environ["OMP_NUM_THREADS"] == "7"


def test_nothing_is_set_once_torch_is_loaded(fresh):
    fresh.setitem(sys.modules, "torch", object())
    threads.set_defaults()
    assert "OMP_WAIT_POLICY" not in os.environ


@pytest.mark.parametrize(
    ("files", "limit"),
    [
        ({"cpu.max": "150000 100000\n"}, 2),
        ({"cpu.max": "max 100000\n"}, None),
        ({"cpu/cpu.cfs_quota_us": "400000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 4),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, None),
        ({}, None),
    ],
)
def test_the_limit_is_read_from_either_kind_of_control_group(tmp_path, files, limit):
    (tmp_path / "cpu").mkdir()
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    assert threads.cpu_limit(tmp_path) == limit


@pytest.mark.parametrize("start", ["main(['inspect', 'nowhere'])", "Denoiser()"])
def test_programs_and_sessions_set_them_before_torch_is_loaded(start):
    code = f"""
import os, sys
class Watch:
    def find_spec(self, name, *_):
        if name == "torch":
            seen.append(os.environ.get("OMP_WAIT_POLICY"))
seen = []
sys.meta_path.insert(0, Watch())
from rtdenoise.cli.main import main
from rtdenoise import Denoiser
try: {start}
except SystemExit: pass
print(seen[0])
"""
    environment = {key: value for key, value in os.environ.items() if key != "OMP_WAIT_POLICY"}
    result = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert result.stdout.split()[-1:] == ["passive"], result.stderr


def test_compiling_kernels_is_announced_once(tmp_path):
    code = """
import torch
from rtdenoise import ops
image = torch.rand(1, 3, 8, 8)
ops.downsample(image), ops.apply_kernel(image, torch.zeros(1, 9, 8, 8))
"""
    lines = [
        subprocess.run(
            [sys.executable, "-c", code], env=os.environ | {"XDG_CACHE_HOME": str(tmp_path)}, capture_output=True,
            text=True,
        ).stderr.splitlines()
        for _ in range(2)
    ]  # fmt: skip
    assert len(lines[0]) == 1 and "compiling kernels for this CPU once, about" in lines[0][0]
    assert lines[1] == []
