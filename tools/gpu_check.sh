#!/bin/sh
# Check and time the GPU paths on a machine with an NVIDIA GPU:  sh tools/gpu_check.sh [tests|table]
#
# `tests`: Triton's kernels, CUDA graphs and the shaders compute the same as the plain ops. `table`: times, into
# bench/results/latency_720p_cuda.json and docs/results/performance.md. Either takes ten minutes at most; without an argument it does both.
#
# Where python3 (or PYTHON=...) has a PyTorch that sees the GPU, that one is used, and nothing is asked of the network unless
# other packages are missing. WHEELS=FOLDER takes those from a folder of wheels instead: they go into build/gpu-venv, beside
# the packages that are there. Without such a PyTorch tools/setup.sh downloads one into .venv.
set -eu
cd "$(dirname "$0")/.."

main() {
    part=${1:-both}
    case $part in tests | table | both) ;; *) fail "expected tests, table or nothing, got '$part'" ;; esac
    nvidia-smi --query-gpu=name,driver_version,memory.total --format=csv,noheader ||
        fail "expected an NVIDIA GPU and its driver, found none; nothing was measured"
    find_python
    add_packages
    export PYTHONPATH="$PWD${PYTHONPATH:+:$PYTHONPATH}"

    # The table is written even if a test fails: a wrong method gets no time there.
    failed=0
    if [ "$part" != table ]; then # in two runs, because Triton must not be loaded after OpenGL
        timeout 420 "$python" -m pytest -q -n auto tests/test_ops.py tests/test_ops_fused.py \
            tests/test_ops_fused_frames.py tests/test_ops_dispatch.py tests/test_precision.py tests/test_graphed.py \
            tests/test_elsewhere.py || failed=1
        if has moderngl; then
            timeout 150 "$python" -m pytest -q -n auto tests/test_glsl.py tests/test_glsl_pipeline.py || failed=1
        fi
    fi
    if [ "$part" != tests ]; then
        timeout 570 "$python" bench/latency_720p.py --device cuda || failed=1
    fi
    exit $failed
}

fail() { echo "gpu_check: $*" >&2; exit 2; }
sees_gpu() { "$1" -c 'import sys, torch; sys.exit(not torch.cuda.is_available())' 2>/dev/null; }
has() { "$python" -c 'import importlib.util, sys; sys.exit(not importlib.util.find_spec(sys.argv[1]))' "$1"; }

# Into $python: an interpreter whose PyTorch sees the GPU.
find_python() {
    for python in "${PYTHON:-python3}" build/gpu-venv/bin/python .venv/bin/python; do
        if sees_gpu "$python"; then return; fi
    done
    [ -z "${WHEELS-}" ] || fail "the PyTorch of ${PYTHON:-python3} does not see the GPU; PYTHON=... names another interpreter"
    sh tools/setup.sh gpu
    python=.venv/bin/python
    sees_gpu "$python" || fail "the PyTorch in .venv does not see the GPU; TORCH=... names another build for tools/setup.sh"
}

# Packages that tests and table need. PyTorch and Triton are never installed here; OIDN and matplotlib may be missing.
add_packages() {
    missing=
    for pair in numpy:numpy PIL:pillow tyro:tyro rich:rich safetensors:safetensors OpenEXR:OpenEXR \
        skimage:scikit-image moderngl:moderngl pytest:pytest xdist:pytest-xdist hypothesis:hypothesis; do
        has "${pair%:*}" || missing="$missing ${pair#*:}"
    done
    [ -n "$missing" ] || return 0
    echo "gpu_check: installing$missing"
    extend_python
    "$python" -m pip --quiet --disable-pip-version-check install ${WHEELS:+--no-index --find-links "$WHEELS"} $missing ||
        fail "missing:$missing; WHEELS=FOLDER takes them from a folder of wheels"
}

# $python becomes build/gpu-venv, which sees the packages of the interpreter that it was before.
extend_python() {
    [ "$python" != build/gpu-venv/bin/python ] || return 0
    folders=$("$python" -c 'import site; print(*site.getsitepackages(), sep="\n")')
    "$python" -m venv build/gpu-venv || fail "$python comes without venv; install$missing for it"
    python=build/gpu-venv/bin/python
    echo "$folders" > "$("$python" -c 'import site; print(site.getsitepackages()[0])')/parent.pth"
}

main "$@"
