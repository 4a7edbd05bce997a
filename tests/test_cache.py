"""Compiled code: nothing damaged and nothing foreign is loaded, and without a cache the plain ops run."""

import contextlib
import ctypes
import logging
import os
import resource
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch

from rtdenoise import ops
from rtdenoise.ops import dispatch
from rtdenoise.ops.native import cache, compiler

IMAGE = torch.rand(1, 3, 9, 7, generator=torch.Generator().manual_seed(0))


@pytest.fixture
def place(tmp_path, monkeypatch):
    """The folder of an empty cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    forget()
    yield tmp_path / "rtdenoise"
    forget()


def forget():
    """As a new process."""
    compiler.library.cache_clear(), compiler._threads.cache_clear()
    dispatch.backend.cache_clear(), dispatch._lost.clear()


def downsampled(choice="fused"):
    with ops.use(choice):
        return ops.downsample(IMAGE)


def compiled(place):
    """The one library in the cache, after a first run."""
    assert torch.allclose(downsampled(), downsampled("plain"))
    (path,) = place.glob("downsample-*")
    forget()
    return path


def replace(path, content):
    """Another file under this name: this process still maps the first one."""
    path.unlink()
    path.write_bytes(content)
    path.chmod(0o700)


def plain_with_one_warning(caplog, expected, op=downsampled):
    with caplog.at_level(logging.WARNING):
        first, again = op("auto"), op("auto")
    assert torch.equal(first, op("plain")) and torch.equal(again, first)
    (record,) = caplog.records
    assert "slower without fused ops" in record.getMessage() and expected in record.getMessage(), record.getMessage()


@pytest.mark.parametrize("length", [0, 100, 0.5, 0.99])
def test_a_truncated_library_is_compiled_again(place, length):
    path = compiled(place)
    whole = path.read_bytes()
    replace(path, whole[: length if isinstance(length, int) else int(length * len(whole))])
    downsampled()
    (mended,) = place.glob("downsample-*")
    assert mended.stat().st_size == len(whole)


def test_a_library_that_lost_one_bit_is_compiled_again(place):
    path = compiled(place)
    damaged = bytearray(path.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    replace(path, damaged)
    downsampled()
    assert [found.read_bytes() for found in place.glob("downsample-*")] != [bytes(damaged)]


@pytest.mark.parametrize("planted", [b"", b"not a library", None], ids=["empty", "text", "without its symbols"])
def test_a_file_with_a_valid_checksum_that_is_not_the_library(place, tmp_path, planted):
    path = compiled(place)
    if planted is None:
        command = [compiler._compiler(), "-shared", "-x", "c", "-", "-o", str(tmp_path / "empty.so")]
        subprocess.run(command, input=b"", check=True)
        planted = (tmp_path / "empty.so").read_bytes()
    foreign = place / f"{path.stem.rpartition('-')[0]}-{cache._checksum(planted)}.so"
    path.rename(foreign)
    replace(foreign, planted)
    downsampled()
    assert [found.name for found in place.glob("downsample-*")] == [path.name]


def test_a_link_in_the_cache_is_not_followed(place, tmp_path):
    path = compiled(place)
    path.rename(tmp_path / "elsewhere.so")
    path.symlink_to(tmp_path / "elsewhere.so")
    downsampled()
    assert not path.is_symlink()


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777])
def test_a_folder_that_others_may_write_to_is_refused(place, caplog, mode):
    compiled(place)
    place.chmod(mode)
    plain_with_one_warning(caplog, "others may write to it, so its code is not run; chmod go-w it")


def test_a_file_that_others_may_write_to_is_refused(place, caplog):
    compiled(place).chmod(0o777)
    plain_with_one_warning(caplog, "others may write to it")


def test_a_folder_of_another_user_is_refused(place, caplog, monkeypatch):
    path = compiled(place)
    if os.getuid() == 0:
        os.chown(place, 65534, 65534)
    else:
        monkeypatch.setattr(os, "getuid", lambda: path.stat().st_uid + 1)
    plain_with_one_warning(caplog, "belongs to another user, so its code is not run; set XDG_CACHE_HOME")


def test_a_new_folder_is_its_owners_alone(place):
    before = os.umask(0)
    try:
        compiled(place)
    finally:
        os.umask(before)
    assert place.stat().st_mode & 0o077 == 0 and not any(path.stat().st_mode & 0o077 for path in place.iterdir())


@contextlib.contextmanager
def full_disk():
    """No file may grow beyond 1 KB: the system's own refusal. The compiler is stopped by it as by a full disk. It ends
    with the block, before the test runner reports the result, perhaps into a longer file."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_runs_plain(place, caplog):
    with full_disk():
        plain_with_one_warning(caplog, "failed")
    assert not any(place.iterdir())


def test_a_disk_that_has_filled_up_since_the_start_runs_plain(place, caplog):
    """Ops that need another library than the first: forward with a gradient to come, and without."""
    compiled(place)
    downsampled()
    image, motion = IMAGE.clone().requires_grad_(), torch.full((1, 2, 9, 7), 0.5)

    def warped(choice):
        with ops.use(choice):
            return ops.warp(image, motion)

    with full_disk():
        plain_with_one_warning(caplog, "failed", warped)
        warped("auto").sum().backward()
    assert image.grad.isfinite().all()
    with full_disk(), pytest.raises(RuntimeError, match="no fused path"):
        warped("fused")


def test_threads_that_need_one_library_compile_it_once(place, monkeypatch):
    built, compile_ = [], compiler._compile
    monkeypatch.setattr(compiler, "_compile", lambda *given: built.append(given[-1]) or compile_(*given))
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(lambda _: compiler.library("downsample", POOL=0).downsample, range(4)))
    assert len(found) == 4 and len(built) == len(list(place.glob("*.so"))) > 0


def test_a_read_only_cache_is_used(place, monkeypatch):
    """As on a machine whose administrator has filled it."""
    path = compiled(place)
    monkeypatch.setattr(compiler, "_compile", lambda *_: pytest.fail("compiled again"))
    path.chmod(0o500), place.chmod(0o500)
    downsampled()
    place.chmod(0o700)


def test_processors_that_share_a_home_folder_keep_their_own_code(place, monkeypatch):
    compiled(place)
    monkeypatch.setattr(compiler, "machine", lambda: "another processor")
    downsampled()
    assert len({path.stem.split("-")[1] for path in place.glob("downsample-*")}) == 2
    forget()
    monkeypatch.setattr(compiler, "_compile", lambda *_: pytest.fail("compiled again"))
    downsampled()


def test_the_key_holds_what_the_processor_can_do():
    """-march=native compiles for the processor's features: where the system lists them, they decide the key."""
    listed = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith(("flags", "Features"))]
    assert listed and listed[0] in compiler.machine()


def test_loading_does_not_trust_the_name_alone(place):
    """A library of another op under this op's name: whole, ours, but with another key."""
    path = compiled(place)
    compiler.library("fetch", C=3)
    (other,) = place.glob("fetch-*")
    path.unlink()
    other.rename(place / f"{path.stem.rpartition('-')[0]}-{other.stem.rpartition('-')[2]}.so")
    forget()
    downsampled()
    assert path.exists() and isinstance(compiler.library("downsample", POOL=0), ctypes.CDLL)


OTHER_COMPILERS = {  # as clang is: without OpenMP, or with one that PyTorch does not have
    "no OpenMP": """case " $* " in *" -fopenmp "*) echo "error: unsupported option '-fopenmp'" >&2; exit 1;; esac
exec gcc "$@"
""",
    "another OpenMP": """case " $* " in *" -fopenmp "*)
    { cat; echo 'void __kmpc_fork(void); void *needed(void) { return (void *)__kmpc_fork; }'; } | gcc "$@"; exit;; esac
exec gcc "$@"
""",
}


@pytest.mark.parametrize("script", OTHER_COMPILERS.values(), ids=OTHER_COMPILERS)
def test_a_compiler_without_torchs_threads_compiles_for_one(place, tmp_path, monkeypatch, caplog, script):
    other = tmp_path / "other"
    other.write_text(f"#!/bin/sh\n{script}")
    other.chmod(0o755)
    monkeypatch.setenv("CC", str(other))
    expected = downsampled("plain")
    with caplog.at_level(logging.WARNING, "rtdenoise"):
        assert torch.equal(downsampled(), expected)
    assert [m for m in caplog.messages if "one thread" in m] == [
        f"rtdenoise: kernels run on one thread: {other} does not share OpenMP with PyTorch; gcc does"
    ]
    assert not any("slower" in message for message in caplog.messages)
