#!/bin/sh
# Set up .venv for `make demo`, `make test`, `make wheel` or tools/gpu_check.sh; skips what is there:
#
#   sh tools/setup.sh demo|test|build|gpu
#
#   demo   .venv with PyTorch and the package
#   build  .venv with the package's builder alone
#   gpu    and the extras of GPU tests and benchmarks; Mesa's OpenGL where the driver brings none
#   test   and all extras; Mesa's OpenGL for the shaders, LLVM for rendering with Mitsuba, a browser for the report,
#          glslang for exported shaders
#
# PYTHON and TORCH in the environment name another interpreter and another build of PyTorch. System packages are installed
# with apt where this runs as root; elsewhere a line says what to type.
set -eu
cd "$(dirname "$0")/.."

GL_PACKAGES="libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri"
LLVM_VERSIONS="19 20 18 17 16"  # in order of preference; Mitsuba 3.9 aborts with 15
TORCH_CPU_INDEX=https://download.pytorch.org/whl/cpu
TORCH_FALLBACK=torch==2.13.0  # where that index is out of reach

main() {
    case "${1-}" in
        demo) extras="[torch]" ;;
        test) extras="[render,noisebase,tensorboard,bench,farm,dev]" ;;
        gpu) extras="[bench,dev]" ;;
        build)
            make_venv
            say "installing build"
            pip install build
            return
            ;;
        *) fail "usage: sh tools/setup.sh demo|test|build|gpu" ;;
    esac
    make_venv
    install_torch
    say "installing rtdenoise$extras"
    pip install --editable ".$extras"
    if [ "$1" != demo ]; then
        has_gl || install "OpenGL (Mesa)" $GL_PACKAGES
    fi
    if [ "$1" = test ]; then
        has_mitsuba || install "a library for Mitsuba" libatomic1
        has_llvm || install_llvm
        has_blender_libraries || install "libraries for Blender" libxi6 libxxf86vm1 libxfixes3 libxrender1 libxkbcommon0 libsm6
        has_browser || install "a browser" chromium
        command -v glslangValidator >/dev/null || install "glslang, for SPIR-V," glslang-tools
    fi
}

say() { echo "setup: $*"; }
fail() { echo "setup: $*" >&2; exit 1; }
# Without bytecode: Python writes it of what is imported, a quarter of all.
pip() { .venv/bin/python -m pip --quiet --disable-pip-version-check "$@" --no-compile; }

# A virtual environment, with the first Python that is recent enough and can make one.
make_venv() {
    if .venv/bin/python -m pip --version >/dev/null 2>&1; then return; fi
    recent=""
    for python in ${PYTHON:-python3 python3.14 python3.13 python3.12 python3.11}; do
        "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || continue
        recent=${recent:-$python}
        if "$python" -c 'import ensurepip, venv' 2>/dev/null; then found=$python; break; fi
    done
    [ -n "$recent" ] ||
        fail "expected Python 3.11 or later, found $("${PYTHON:-python3}" --version 2>&1 || true); PYTHON=… names another"
    if [ -z "${found-}" ]; then
        package=$("$recent" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
        can_install || fail "$recent comes without venv; type: sudo apt-get install -y $package"
        install "venv for $recent" "$package"
        found=$recent
    fi
    say "creating .venv with $("$found" --version)"
    "$found" -m venv --clear .venv
}

# PyTorch first: as a dependency pip would install its default build, several GB of CUDA that need an NVIDIA GPU.
install_torch() {
    wanted=$(sed -n 's/^ *"\(torch>=[^"]*\)".*/\1/p' pyproject.toml)
    if [ -n "${TORCH-}" ]; then
        say "installing $TORCH"
        pip install "$TORCH"
    elif has_torch "$wanted"; then
        :
    elif nvidia-smi >/dev/null 2>&1; then
        say "installing PyTorch for the NVIDIA GPU"
        pip install "$wanted"
    elif reachable "$TORCH_CPU_INDEX/torch/"; then
        say "installing PyTorch, CPU build"
        pip install --index-url "$TORCH_CPU_INDEX" "$wanted"
    else
        say "installing $TORCH_FALLBACK from pip's own index ($TORCH_CPU_INDEX is out of reach)"
        pip install "$TORCH_FALLBACK"
    fi
}

has_torch() {
    .venv/bin/python - "$1" 2>/dev/null <<'END'
import sys
from importlib.metadata import version
from pip._vendor.packaging.requirements import Requirement
sys.exit(version("torch") not in Requirement(sys.argv[1]).specifier)
END
}

reachable() {
    .venv/bin/python -c 'import sys, urllib.request as u; u.urlopen(sys.argv[1], timeout=5)' "$1" 2>/dev/null
}

# These try the software itself instead of looking for packages: a vendor's OpenGL serves as well as Mesa's.
has_gl() { .venv/bin/python -c 'from rtdenoise.glsl import create_context; create_context()' >/dev/null 2>&1; }

has_mitsuba() { .venv/bin/python -c 'import mitsuba' 2>/dev/null; }

has_blender_libraries() {
    .venv/bin/python -c 'from ctypes import CDLL
for name in ("Xi.so.6", "Xxf86vm.so.1", "Xfixes.so.3", "Xrender.so.1", "xkbcommon.so.0", "SM.so.6"): CDLL("lib" + name)' 2>/dev/null
}

has_llvm() {
    [ -n "${DRJIT_LIBLLVM_PATH-}" ] ||
        find /usr/lib /usr/lib64 -name 'libLLVM*.so*' 2>/dev/null | grep -Eq 'libLLVM(-|\.so\.)(1[6-9]|[2-9][0-9])'
}

has_browser() {  # the names that tests/browser.py looks for
    for name in chromium chromium-browser google-chrome chromium-headless-shell chrome; do
        if command -v "$name" >/dev/null; then return; fi
    done
    return 1
}

install_llvm() {
    refresh
    for version in $LLVM_VERSIONS; do
        for name in "libllvm$version" "libllvm${version}t64"; do
            candidate=$(apt-cache policy "$name" 2>/dev/null | sed -n 's/ *Candidate: //p')
            if [ -n "$candidate" ] && [ "$candidate" != "(none)" ]; then install "LLVM" "$name"; return; fi
        done
    done
    say "no LLVM of version 16 or later among the system's packages; rendering with Mitsuba needs one (DRJIT_LIBLLVM_PATH)"
}

# Install system packages, or say how.
install() {
    what=$1; shift
    if ! command -v apt-get >/dev/null; then
        say "$what is missing: install what your system calls $*"
    elif ! can_install; then
        say "$what is missing; type: sudo apt-get install -y $*"
    else
        refresh
        say "installing $what: $*"
        log=$(DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" 2>&1 </dev/null) ||
            fail "apt-get could not install $*: $(echo "$log" | tail -n 1)"
    fi
}

can_install() { [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null; }

# Update the list of packages, once: in a container it is often empty.
refresh() {
    if can_install && [ -z "${refreshed-}" ]; then
        apt-get update -qq >/dev/null || say "apt-get update failed; using the list of packages as it is"
        refreshed=yes
    fi
}

main "$@"
