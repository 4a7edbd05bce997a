"""On a GPU the first frames compile kernels, and one line says so."""

import os
import subprocess
import sys

import triton

from rtdenoise.ops import dispatch

COMPILE = """
import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource
from rtdenoise.ops.triton import first_use
from rtdenoise.ops.triton.max_pool import _max_pool

first_use.listen_to_compilations()
for run in (512, 1024):
    signature = {"x": "*fp32", "out": "*fp32", "w": "i32", "C": "i32", "RUN": "constexpr"}
    triton.compile(ASTSource(_max_pool, signature, {(4,): run}), target=GPUTarget("cuda", 80, 32))
"""


def test_one_line_says_that_kernels_are_compiled(tmp_path):
    environment = {name: value for name, value in os.environ.items() if name != "TRITON_INTERPRET"}
    environment["TRITON_CACHE_DIR"] = str(tmp_path)
    for said in (1, 0):  # the second process finds them
        run = subprocess.run([sys.executable, "-c", COMPILE], capture_output=True, text=True, env=environment)
        assert run.returncode == 0, run.stderr
        assert run.stderr.count(f"compiling kernels for this GPU once, about 30 s; they are kept in {tmp_path}") == said


def test_an_old_triton_is_left_alone(monkeypatch, caplog):
    monkeypatch.setattr(triton, "__version__", "3.2.0")
    dispatch.backend.cache_clear()
    try:
        folder, problem = dispatch.backend("cuda")
    finally:
        dispatch.backend.cache_clear()
    assert folder is None and problem == "Triton 3.2.0 is older than 3.4, which comes with PyTorch 2.8"
    assert "slower without fused ops on cuda: Triton 3.2.0" in caplog.text
