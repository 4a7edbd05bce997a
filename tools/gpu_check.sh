#!/bin/sh
# On a machine with an NVIDIA GPU, in one call of at most ten minutes:  sh tools/gpu_check.sh
#
# Sets up .venv with PyTorch for CUDA and, where the driver has none, OpenGL; tests that Triton's kernels, CUDA graphs and
# the shaders compute what the plain ops do; then writes the table of times, bench/results/latency_720p_cuda.{json,md,png}.
set -eu
cd "$(dirname "$0")/.."

nvidia-smi --query-gpu=name,driver_version,memory.total --format=csv,noheader ||
    { echo "gpu_check: expected an NVIDIA GPU and its driver, found none; nothing was measured" >&2; exit 2; }
sh tools/setup.sh gpu
.venv/bin/python -c 'import sys, torch; sys.exit(None if torch.cuda.is_available() else
    f"gpu_check: PyTorch {torch.__version__} does not see the GPU; TORCH=... names another build for tools/setup.sh")'

# In two processes: Triton must not be loaded after OpenGL. Set-up is not in these 540 s; all have their share of them. The
# table is written whatever fails before it: what is wrong gets no time there, by a check of its own.
failed=0
timeout 120 .venv/bin/python -m pytest -q tests/test_ops.py tests/test_ops_fused.py tests/test_precision.py \
    tests/test_graphed.py || failed=1
timeout 120 .venv/bin/python -m pytest -q tests/test_glsl.py tests/test_glsl_pipeline.py || failed=1
timeout 300 .venv/bin/python bench/latency_720p.py --device cuda --out bench/results/latency_720p_cuda.json || failed=1
exit $failed
