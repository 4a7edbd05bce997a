"""Which implementation of an op runs, and why: declarations, arguments that do not fit, derivatives, devices, and what
a machine lacks."""

import contextlib
import importlib
import logging
import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch._subclasses import FakeTensorMode
from torch.autograd import forward_ad

from rtdenoise import ops
from rtdenoise.frame import Frame, History
from rtdenoise.ops import dispatch, pixels
from rtdenoise.ops.agrees import agrees
from rtdenoise.ops.around import expand_within
from rtdenoise.ops.blend_history import blend_history
from rtdenoise.ops.block_luminance import block_luminance
from rtdenoise.ops.even_sky import even_sky
from rtdenoise.ops.feature_bytes import feature_bytes
from rtdenoise.ops.fireflies import without_fireflies
from rtdenoise.ops.keep import keep
from rtdenoise.ops.max_pool import FUSED as MAX_POOL
from rtdenoise.ops.mix import mix
from rtdenoise.ops.native import compiler
from rtdenoise.ops.over import over
from rtdenoise.ops.recall import recall
from rtdenoise.ops.relit import gain
from rtdenoise.ops.soften import soften
from rtdenoise.ops.turned import turned
from rtdenoise.shift.displacement import displacement_sums
from rtdenoise.splat import history_motion


def test_the_triton_kernels_compile_for_a_gpu():
    """The interpreter does not show this. Needs no GPU."""
    environment = {name: value for name, value in os.environ.items() if name != "TRITON_INTERPRET"}
    script = Path(__file__).with_name("kernels_for_a_gpu.py")
    result = subprocess.run([sys.executable, script], capture_output=True, text=True, env=environment)
    assert result.returncode == 0, result.stderr


def declarations():
    """(module, `Fused`) for every op with a fused implementation."""
    names = (f"ops.{module.name}" for module in pkgutil.iter_modules(ops.__path__))
    for name in ["splat", "shift.displacement", "shift.light", "shift.picture", *names]:
        module = importlib.import_module(f"rtdenoise.{name}")
        yield from ((module, value) for value in vars(module).values() if isinstance(value, dispatch.Fused))


def test_every_fused_op_has_the_name_of_its_plain_one():
    """Declared implementations exist; every file of a folder belongs to an op or is shared."""
    shared = {"__init__", "cache", "compiler", "logits"}
    device = {"common", "pool", "targets", "alike", "path", "curve", "cells", "luminance", "logits"}
    device |= {"first_use"}  # before them all
    device |= {"keep", "unchanged"}  # parts of `recall`
    files = {"native": {*shared}, "triton": {"__init__", *device}}
    for module, fused in declarations():
        assert callable(getattr(module, fused.name).__wrapped__)  # decorated by `falls_back`
        assert module.__name__ in (f"rtdenoise.ops.{fused.file}", "rtdenoise.splat") or ".shift." in module.__name__
        for folder in fused.support:
            assert callable(dispatch._function(folder, fused.file, fused.name))
            files[folder].add(fused.file)
    for folder, expected in files.items():
        assert {file.stem for file in (Path(*ops.__path__) / folder).glob("*.py")} == expected
    sources = {file.stem for file in (Path(*ops.__path__) / "native").glob("*.c")}
    # apply_kernel.c blends; convolve_bytes.py asks multiplies_bytes.c, and has two ways
    assert sources == files["native"] - {*shared, "blend_history"} | {"multiplies_bytes", "convolve_pairs"}


def test_the_page_of_backends_names_what_is_fused():
    page = (Path(__file__).parents[1] / "docs" / "reference" / "backends.md").read_text()
    covers = {line.split(" | ")[0]: line.split(" | ")[3] for line in page.splitlines() if line.startswith("| C")}
    same, more = covers["| CUDA"].split("but for")[1].split(";")
    native, without, more = (set(re.findall(r"`(\w+)`", part)) for part in (covers["| CPU"], same, more))
    single = {"pixels", "lift"}  # the operations on single pixels
    for folder, named in (("native", native), ("triton", native - without | more)):
        fused = [op for _, op in declarations() if folder in op.support and op.file not in single]
        assert all({op.name, op.file} & named for op in fused), folder
        assert named <= {name for op in fused for name in (op.name, op.file)}, folder


@pytest.mark.parametrize(
    "arguments, problem",
    [
        (lambda: (torch.rand(1, 9, 8, 9), torch.randn(1, 9, 8, 9)), "at most 8 channels, not 9"),
        (lambda: (torch.rand(1, 3, 8, 9), torch.randn(1, 81, 8, 9)), "at most 7², not 81 taps"),
        (lambda: (torch.rand(0, 3, 8, 9), torch.randn(0, 9, 8, 9)), r"no images of \(0, 3, 8, 9\)"),
    ],
)
def test_the_reason_for_running_plain_is_given(arguments, problem):
    image, logits = arguments()
    with ops.use("auto"):
        assert ops.apply_kernel(image, logits).shape == image.shape
    with pytest.raises(RuntimeError, match=problem), ops.use("fused"):
        ops.apply_kernel(image, logits)


def test_a_grid_has_room_for_the_rows_of_a_picture(monkeypatch):
    """For those of all channels, unless a program has these together."""
    monkeypatch.setattr(dispatch, "backend", lambda _: ("triton", None))
    wide, long = torch.empty(1, 64, 2160, 2, device="meta"), torch.empty(1, 1, 65536, 2, device="meta")
    assert MAX_POOL(x=wide) and not MAX_POOL(x=long) and not pixels.NEARNESS(depth=wide)


def test_kernels_run_on_the_gpu_of_their_tensors(monkeypatch):
    current = [0]

    @contextlib.contextmanager
    def on(device):
        current.append(device.index)
        yield
        current.pop()

    monkeypatch.setattr(torch.cuda, "device", on)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: current[-1])
    monkeypatch.setattr(dispatch, "backend", lambda _: ("triton", None))
    monkeypatch.setattr(dispatch, "_function", lambda *_: lambda: current[-1])
    op = dispatch.Fused("joined", triton=dispatch.Support())
    with FakeTensorMode():
        images = [torch.empty(1, 3, 8, 9, device=f"cuda:{n}") for n in range(2)]
        assert [op(a=image)() for image in images] == [0, 1]
        assert op(a=images[0], b=images[1]) is None  # torch says what does not fit


def test_without_what_triton_needs_the_plain_ops_run_and_a_warning_says_so(monkeypatch, caplog):
    def fails():
        raise subprocess.CalledProcessError(1, "gcc")

    monkeypatch.setattr(importlib.import_module("rtdenoise.ops.triton.first_use"), "prepare", fails)
    with caplog.at_level(logging.WARNING):
        folder, why = dispatch.backend.__wrapped__("cuda")
    assert folder is None and "gcc" in why and "slower without fused ops on cuda" in caplog.text


def test_a_temporal_kernel_of_other_sizes_is_refused():
    image, seen, alpha = torch.rand(2, 3, 8, 9), torch.ones(2, 1, 8, 9, dtype=torch.bool), torch.rand(2, 1, 8, 9)
    for logits in (torch.zeros(1, 9, 8, 9), torch.zeros(2, 9, 8, 8), torch.zeros(2, 8, 8, 9)):
        with pytest.raises(ValueError, match="expected logits"):
            blend_history(image, image, seen, logits, alpha)


def test_a_fused_op_without_the_gradient_that_is_asked_for_says_so():
    image = torch.rand(1, 3, 8, 9, requires_grad=True)
    with pytest.raises(RuntimeError, match="no gradient in image"), ops.use("fused"):
        ops.downsample(image)
    with torch.no_grad(), ops.use("fused"):
        ops.downsample(image)


def test_the_choice_can_be_forced_and_is_taken_back():
    image, logits = torch.rand(1, 3, 8, 9).double(), torch.randn(1, 25, 8, 9)
    with ops.use("auto"):
        assert ops.apply_kernel(image, logits).dtype == torch.float64  # plain: there is no fused one for doubles
    with pytest.raises(RuntimeError, match="image is float64"), ops.use("fused"):
        ops.apply_kernel(image, logits)
    with pytest.raises(ValueError, match="'quick'"), ops.use("quick"):
        pass
    assert dispatch._choice == os.environ.get("RTDENOISE_OPS", "auto")


def test_blocks_that_overlap_are_taken_back_in_any_order():
    """As those of two threads do."""
    first, second = ops.use("plain"), ops.use("fused")
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert dispatch._choice == "fused"
    second.__exit__(None, None, None)
    assert dispatch._choice == os.environ.get("RTDENOISE_OPS", "auto")


@pytest.mark.parametrize("compiler_is", ["absent", "failing"])
def test_without_a_compiler_the_plain_ops_run_and_one_warning_says_so(compiler_is, monkeypatch, tmp_path, caplog):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("CC", "false" if compiler_is == "failing" else "")
    monkeypatch.setattr(compiler, "COMPILERS", ())
    compiler.library.cache_clear(), dispatch.backend.cache_clear()
    image, logits = torch.rand(1, 3, 8, 9), torch.randn(1, 25, 8, 9)
    try:
        with caplog.at_level(logging.WARNING):
            first, again = ops.apply_kernel(image, logits), ops.apply_kernel(image, logits)
        with ops.use("plain"):
            assert torch.equal(first, ops.apply_kernel(image, logits)) and torch.equal(first, again)
        with pytest.raises(RuntimeError, match=r"no C compiler|failed"), ops.use("fused"):
            ops.apply_kernel(image, logits)
    finally:
        compiler.library.cache_clear(), dispatch.backend.cache_clear()
    messages = [record.getMessage() for record in caplog.records]
    (slower,) = (message for message in messages if "compiling kernels" not in message)
    assert "slower without fused ops on cpu" in slower
    assert not list(tmp_path.rglob("*.so"))


MOVES = torch.rand(1, 2, 8, 9, generator=torch.Generator().manual_seed(0))


KEYS, OFFSETS = torch.rand(1, 4, 8, 9, generator=torch.Generator().manual_seed(1)), torch.zeros(2, 14)


LINEAR = {  # in their picture of 4 channels
    "downsample": ops.downsample,
    "warp": lambda x: ops.warp(x, MOVES),
    "warp of 12 channels": lambda x: ops.warp(x.repeat(1, 3, 1, 1), MOVES),
    "fetch": lambda x: ops.fetch(x, MOVES),
    "apply_kernel": lambda x: ops.apply_kernel(x, MOVES[:, :1].repeat(1, 25, 1, 1)),
    "attend_blocks": lambda x: ops.attend_blocks(KEYS, KEYS, x, OFFSETS, OFFSETS, heads=1),
}


@pytest.mark.parametrize("op", LINEAR.values(), ids=LINEAR)
def test_derivatives_in_forward_mode_are_not_lost(op):
    image, tangent = torch.rand(2, 1, 4, 8, 9, generator=torch.Generator().manual_seed(0))
    with forward_ad.dual_level():
        found = forward_ad.unpack_dual(op(forward_ad.make_dual(image, tangent))).tangent
    with ops.use("plain"):
        assert torch.allclose(found, op(image + tangent) - op(image), atol=1e-6)  # linear


@pytest.mark.parametrize("op", LINEAR.values(), ids=LINEAR)
def test_transforms_of_functions_take_the_plain_ops(op):
    images = torch.rand(3, 1, 4, 8, 9, generator=torch.Generator().manual_seed(0))
    with ops.use("plain"):
        expected = torch.stack([op(image) for image in images])
    torch.testing.assert_close(torch.vmap(op)(images), expected)
    _, moved = torch.func.jvp(op, (images[0],), (images[1],))
    torch.testing.assert_close(moved, expected[1])  # linear
    slope = torch.func.grad(lambda x: op(x).sum())(images[0])
    torch.testing.assert_close((slope * images[1]).sum(), expected[1].sum())


def misfits():
    """(op, its arguments, which one is exchanged for what) for the ops of single pixels and their like."""
    generator = torch.Generator().manual_seed(0)

    def image(channels, B=2, H=8, W=12, more=0):
        return torch.rand(B, channels + more, H, W, generator=generator)

    frame, other = keep(image(3), image(1), image(3), image(1), image(2), image(3)), (image(3), image(1), image(3))

    def looked_up(light, motion, depth, normal):
        return recall(light, motion, (depth, normal), [frame], torch.zeros(2, 1, 8, 12, dtype=torch.bool)).light

    def chosen(motion, motion_next):
        color, depth, normal = other
        return history_motion(Frame(color, motion=motion, depth=depth), History(color, motion_next, depth, normal))[0]

    def filtered(past, spatial, alpha):
        return blend_history(spatial, past, torch.ones(2, 1, 8, 12, dtype=torch.bool), torch.zeros(2, 9, 8, 12), alpha)

    def sums(now, before, motion, here, depth, was):
        return displacement_sums(now, before, motion, torch.zeros(2, 2, 1, 2), here, depth, was, 8, 2)

    scale = torch.ones(2, 1, 1, 1)
    found = {
        "demodulate": (pixels.demodulate, (3, 3, 1)),
        "modulate": (pixels.modulate, (3, 3, 3, 1, 1)),
        "joined": (lambda *a: torch.cat(pixels.joined(*a), 1), (3, 1, 3, 1)),
        "accumulate": (lambda *a: torch.cat(pixels.accumulate(*a, 9.0), 1), (3, 3, 1, 1)),
        "without_fireflies": (without_fireflies, (3, 1, 3, 1)),
        "even_sky": (lambda image, light, depth: even_sky(image, light, depth - 0.5), (3, 3, 1)),
        "keep": (keep, (3, 1, 3, 1, 2, 3)),
        "recall": (looked_up, (3, 2, 1, 3)),
        "history_motion": (chosen, (2, 2)),
        "mix": (lambda a, b, trust, c, held: mix(a, b, scale, trust, (0.4, 0.1, 0.1), c, held), (3, 3, 1, 3, 1)),
        "soften": (soften, (3, 3, 1)),
        "blend_history": (filtered, (3, 3, 1)),
        "expand_within": (expand_within, (3, 3, 3)),
        "displacement_sums": (sums, (1, 1, 2, 1, 1, 1)),
        "block_luminance": (lambda x: torch.stack(block_luminance(x, 4)), (3,)),
        "feature_bytes": (feature_bytes, (3, 3, 3)),
        "turned": (turned, (3, 3)),
        "gain": (lambda before, now, found: gain(before, now, found > 0.5), (3, 3, 1)),
        "agrees": (lambda light, mean, found: agrees(light, mean, found > 0.5), (3, 3, 1)),
        "over": (lambda seen, motion, depth: over(seen, seen, motion, depth, [frame]), (9, 2, 1)),
    }
    for name, (op, channels) in found.items():
        for i in range(len(channels)):
            for size in ({"H": 4, "W": 6}, {"B": 1}, {"H": 1, "W": 1}, {"more": 1}, {"more": -1}):
                arguments = [image(c, **(size if k == i else {})) for k, c in enumerate(channels)]
                yield pytest.param(op, arguments, id=f"{name}-{i}-{'-'.join(size)}")


@pytest.mark.parametrize(
    "op",
    [
        lambda x, elsewhere: ops.warp(x, elsewhere[:, :2]),
        lambda x, elsewhere: ops.warp(x, x[:, :2], elsewhere[:, :1] > 0, x),
        lambda x, elsewhere: pixels.demodulate(x, elsewhere, x[:, :1]),
        lambda x, elsewhere: recall(x, x[:, :2], (x[:, :1], x), [elsewhere[:, [0] * 5].int()]),
    ],
)
def test_tensors_of_another_device_are_refused(op):
    """C would read memory that is not there."""
    image = torch.rand(1, 3, 8, 9)
    with pytest.raises(RuntimeError), ops.use("auto"):
        op(image, image.to("meta"))


@pytest.mark.parametrize(("op", "arguments"), [*misfits()])
def test_arguments_that_do_not_fit_are_as_for_the_specification(op, arguments):
    """Refused, or broadcast to the same result: C reads no memory that is not there."""

    def outcome(choice):
        with ops.use(choice):
            try:
                return op(*arguments)
            except (RuntimeError, ValueError, IndexError):
                return None

    expected, found = outcome("plain"), outcome("auto")
    assert (expected is None) == (found is None)
    if expected is not None:
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5, equal_nan=True)
