"""The C ops under the address and undefined-behaviour sanitizers: python tests/attack_sanitizers.py HxW ... [--few]

Every op runs on ordinary input, NaN, denormals, huge and hostile motion, in all layouts of logits, with gradients where
it has them. Memory of tensors comes from the sanitizer's allocator, so reads and writes beside a tensor end the process
with a report; of instructions for tiles it knows nothing, so these are emulated. Prints a line of JSON for each size:
the calls, which ops made values that are not finite of input without NaN, and which C files were not called. `--few`:
one kernel size and type of logits, for less compilation.

Above 1920×1080 it is fewer kinds of input, each with every op; above 64×64 the C is slightly optimised, for time.

Starts itself again with the sanitizer's library loaded before Python; needs gcc with libasan and libubsan.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

SANITIZERS = ("-g", "-fsanitize=address,undefined,float-cast-overflow,bounds-strict",
              "-fno-sanitize-recover=all", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-shared",
              "-fPIC")  # fmt: skip
KINDS = ("ordinary", "NaN", "denormal", "zero", "motion 1e4", "motion NaN", "motion Inf", "motion 1e30", "bright")
SMALL = 64 * 64  # pixels: up to here every kernel size, type and layout; above it one
LARGE = 1920 * 1080  # pixels: above it the kinds of AT_LARGE
AT_LARGE = ("motion 1e4", "NaN", "denormal")
PASSES_ON = ("history_motion",)  # ops whose result contains the motion as it is; lookups take what is not finite as 0


def start(*arguments: str) -> subprocess.CompletedProcess:
    """Run this file under the sanitizers. Raises FileNotFoundError where gcc lacks them."""
    names = ("libasan.so", "libubsan.so")
    found = [subprocess.check_output(["gcc", f"-print-file-name={name}"], text=True).strip() for name in names]
    if missing := [path for path in found if not Path(path).is_absolute()]:
        raise FileNotFoundError(f"gcc has no {missing[0]}: install libgcc's sanitizers")
    root = Path(__file__).parents[1]
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {
            "LD_PRELOAD": found[0], "ASAN_OPTIONS": "detect_leaks=0", "UBSAN_OPTIONS": "print_stacktrace=1",
            "XDG_CACHE_HOME": cache, "CC": "gcc", "PYTHONPATH": str(root), "UNDER_SANITIZERS": "1",
        }  # fmt: skip
        return subprocess.run([sys.executable, __file__, *arguments], capture_output=True, text=True, env=environment)


def attack(H: int, W: int, few: bool) -> dict[str, object]:
    """Every op at one size, `few`: with one kernel size and type of logits."""
    import torch

    from rtdenoise.ops.native import compiler

    calls, unexpected, called = {}, [], set()
    load, compiler.cache.load = compiler.cache.load, lambda name, *more: called.add(name) or load(name, *more)
    for kind in KINDS if H * W <= LARGE else AT_LARGE:
        for name, results in _calls(H, W, kind, few):
            calls[name] = calls.get(name, 0) + 1
            results = results if isinstance(results, tuple | list) else [results]
            # NaN may come out of NaN that no op promises to keep out: frames are sanitised before they see one
            bad = [r for r in results if isinstance(r, torch.Tensor) and not r.float().isfinite().all()]
            if bad and kind != "NaN" and name not in PASSES_ON:
                unexpected.append(f"{name}, {kind}")
    compiler.cache.load = load
    left_out = {path.stem for path in Path(compiler.__file__).parent.glob("*.c")} - called
    return {"size": [H, W], "calls": sum(calls.values()), "ops": len({name.split()[0] for name in calls}),
            "not_finite": unexpected, "left_out": sorted(left_out)}  # fmt: skip


def _calls(H: int, W: int, kind: str, few: bool) -> Iterator[tuple[str, object]]:
    """(op, result) of each call."""
    import torch

    from rtdenoise import ops
    from rtdenoise.frame import Frame, History
    from rtdenoise.ops import pixels
    from rtdenoise.ops.agrees import agrees
    from rtdenoise.ops.around import expand_within
    from rtdenoise.ops.blend_history import blend_history
    from rtdenoise.ops.block_luminance import block_luminance
    from rtdenoise.ops.dim import dim
    from rtdenoise.ops.even_sky import even_sky
    from rtdenoise.ops.evened import evened, held_and_tells
    from rtdenoise.ops.feature_bytes import feature_bytes
    from rtdenoise.ops.features import features
    from rtdenoise.ops.fireflies import without_fireflies
    from rtdenoise.ops.keep import keep
    from rtdenoise.ops.lift import lift, lower
    from rtdenoise.ops.logits import cells
    from rtdenoise.ops.max_pool import max_pool
    from rtdenoise.ops.mix import mix
    from rtdenoise.ops.over import over_and_coverage
    from rtdenoise.ops.recall import recall
    from rtdenoise.ops.relit import gain, relit_
    from rtdenoise.ops.retextured import retextured
    from rtdenoise.ops.scattered import scattered
    from rtdenoise.ops.settle import settle
    from rtdenoise.ops.shares import shares
    from rtdenoise.ops.soften import soften
    from rtdenoise.ops.to_bytes import to_bytes
    from rtdenoise.ops.turned import turned
    from rtdenoise.ops.unlike import unlike
    from rtdenoise.shift.displacement import displacement_sums
    from rtdenoise.splat import history_motion

    small = H * W <= SMALL
    h, w = (H + 1) // 2, (W + 1) // 2
    image, other = _image(3, H, W, kind), _image(3, H, W, "ordinary")
    coarse, share, alpha = _image(3, h, w, kind), _image(1, H, W, "ordinary"), _image(1, h, w, "ordinary")
    depth, normal, motion = _image(1, H, W, kind), _image(3, H, W, kind), _motion(H, W, kind)
    seen, one = share > 0.5, torch.ones(1, 1, 1, 1)
    for pool in ("mean", "max"):
        yield f"downsample {pool}", ops.downsample(image, pool)
        yield f"compose {pool}", ops.compose(image, coarse, alpha, pool)
    for cubic in (False, True):
        yield f"warp cubic={cubic}", ops.warp(image, motion, cubic=cubic)
        yield f"warp cubic={cubic} seen", ops.warp(image, motion, seen, other, cubic=cubic)
    yield "fetch", ops.fetch(image, motion)
    yield "reproject", ops.reproject([image, share], motion, (depth, normal), (depth, normal))
    yield (
        "history_motion",
        history_motion(
            Frame(other, albedo=other, normal=normal, depth=depth, motion=motion),
            History(other, _motion(H, W, kind), depth, normal),
        ),
    )
    yield "demodulate", pixels.demodulate(other, other, depth)
    yield "modulate", pixels.modulate(other, other, other, share, depth)
    yield "accumulate", pixels.accumulate(image, image, share * 9, share, 32.0)
    yield "nearness", pixels.nearness(depth, one)
    yield "soften", soften(image, other, share)
    for sky in (depth, torch.zeros_like(depth), torch.where(seen, 1.0, 0.0)):
        yield "even_sky", even_sky(other, torch.where(seen, other, 0.5), sky)
    yield "without_fireflies", without_fireflies(other, depth, normal, share)
    yield "dim", dim(image, torch.full((1, 1), 0.1), 2.0)
    yield "unlike", unlike(depth, normal, motion, depth, normal)
    yield "within", pixels.within(image, 0.0, 1.0)
    yield "expand_within", expand_within(3 * other, other, image.abs())
    pictures = other, other.flip(3), one, share, (0.4, 0.1, 0.1)
    told = image.abs(), seen.float(), other, share
    for more in ((), told[:2], told, (*told, depth), (*told, depth, 0.5 * one)):
        yield f"mix {len(more)}", mix(*pictures, *more)
    yield "settle", settle(other, other.flip(3), image.abs(), share, share.flip(3), one)
    yield "block_luminance", block_luminance(image, 8)
    kept = [keep(image, depth, normal, share, _motion(H, W, kind), other) for _ in range(3)]
    yield "keep", keep(image, depth, normal, share, None)
    for for_footprints in ((), (seen,), (seen, one), (seen, one, scattered(depth))):
        yield f"recall {len(for_footprints)}", recall(image, motion, (depth, normal), kept, *for_footprints)
    yield "turned", turned(normal, other)
    yield "lift", lift(image.abs())
    yield "lower", lower(other)
    yield "evened", evened(image, depth, other, share)
    for held in (seen, share):
        yield "held_and_tells", held_and_tells(held, torch.float32)
    yield "agrees", agrees(image, other, seen)
    brighter = gain(image, other, seen)
    yield "gain", brighter
    yield "relit_", relit_(image.clone(), brighter)
    yield "retextured", retextured(image, other, seen)
    yield "scattered", scattered(depth)
    footprint = torch.cat([image, other, normal], dim=1)
    yield "over_and_coverage", over_and_coverage(footprint, footprint, motion, depth, kept)
    shift = torch.zeros(1, 2, -(-H // 16), -(-W // 16))
    yield "displacement_sums", displacement_sums(depth, share, motion, shift, share, depth, depth, 16, 2)
    like = torch.zeros(1, 2, 1, 2).contiguous(memory_format=torch.channels_last)  # with one channel it is planes, too
    for dtype in (torch.float32, torch.bfloat16):
        yield "features", features([image], [normal, depth, seen], one, like.to(dtype))
    x = feature_bytes(image, other, normal)
    yield "feature_bytes", x
    for dtype in (torch.uint8, torch.float32, torch.bfloat16):
        wide = _wide(image) if dtype.is_floating_point else _wide(x)
        yield f"max_pool {dtype}", max_pool(wide.to(dtype).contiguous(memory_format=torch.channels_last))
    for dtype in (torch.float32, torch.bfloat16):
        wide = image.abs().to(dtype).contiguous(memory_format=torch.channels_last)
        yield f"to_bytes {dtype}", to_bytes(wide, torch.full((3, 1, 1), 9.0, dtype=dtype))
    for cpu in ("own", "pairs", "tiles") if kind in ("ordinary", "bright") or not few else ("own",):  # tiles take time
        yield from _convolutions(image, other, normal, cpu)
    many = small and not few
    for K in (1, 3, 5, 7) if many else (3,):
        for dtype in (torch.float32, torch.bfloat16, torch.float16) if many else (torch.bfloat16,):
            logits = _logits(K * K, H, W, kind).to(dtype)
            layouts = (
                [logits, logits.contiguous(memory_format=torch.channels_last), cells(logits)] if small else [logits]
            )
            for given in layouts:
                yield f"apply_kernel {K} {dtype}", ops.apply_kernel(image, given)
                yield f"blend_history {K} {dtype}", blend_history(other, image, seen, given, share)
                yield f"pick {K} {dtype}", ops.pick(image, coarse, given, share)
            yield f"shares {K} {dtype}", shares(cells(logits), (H, W))
        yield (
            f"apply_kernel {K} gradients",
            _gradients(lambda i, l: ops.apply_kernel(i, l), image, _logits(K * K, H, W, kind)),
        )
    yield "warp gradients", _gradients(lambda i: ops.warp(i, motion), image)
    yield "warp cubic gradients", _gradients(lambda i: ops.warp(i, motion, cubic=True), image)
    yield (
        "reproject gradients",
        _gradients(lambda i: ops.reproject([i], motion, (depth, normal), (depth, normal))[0], image),
    )


def _convolutions(image, other, normal, cpu: str) -> Iterator[tuple[str, object]]:
    """Of as many channels as fit to vectors and tiles, and of others; by this CPU's "own" instructions, as where there
    are those for "pairs" alone, or by "tiles"."""
    import torch

    from rtdenoise.ops.convolve import convolve, mixed
    from rtdenoise.ops.convolve_bytes import MOST, convolve_bytes, multiplies_bytes
    from rtdenoise.ops.feature_bytes import feature_bytes
    from rtdenoise.ops.native import compiler
    from rtdenoise.ops.native import convolve_bytes as one
    from rtdenoise.ops.native import to_planes as another
    from rtdenoise.ops.to_planes import to_planes

    one.library = another.library = partial(compiler.library, EMULATED=1) if cpu == "tiles" else compiler.library
    own = compiler.library("multiplies_bytes").multiplies_bytes()
    one.multiplies = partial({"own": own, "pairs": one.PAIRS, "tiles": one.BYTES}.get, cpu)
    yield "multiplies_bytes", multiplies_bytes()
    H, W = image.shape[2:]
    x = feature_bytes(image, other, normal)
    fine = feature_bytes(*(_wide(layer) for layer in (image, other, normal)))
    whole = torch.arange(9 * 3 * 64 * 4).to(torch.int8).view(1, 27, 64, 4)
    for outputs in (48, 13):
        numbers = torch.full((4, outputs), 0.01), torch.zeros(4, outputs)
        weight = whole[:, :, : -(-outputs // 32) * 32]
        both = torch.cat([weight[:, :12], weight], dim=1).expand(4, -1, -1, -1)
        for dtype in (torch.uint8, torch.bfloat16):
            yield "convolve_bytes", convolve_bytes(x, weight, *(n[:1] for n in numbers), dtype=dtype)
            yield "convolve_bytes below", convolve_bytes(fine, both, *numbers, x, dtype)
    if H * W <= SMALL:
        most = x.repeat(1, MOST // x.shape[1] + 1, 1, 1)[:, :MOST].contiguous(memory_format=torch.channels_last)
        weight, numbers = torch.ones(1, 9 * MOST // 4, 32, 4, dtype=torch.int8), torch.ones(2, 1, 32)
        yield "convolve_bytes most", convolve_bytes(most, weight, *numbers)
    for channels in (3, 20):
        x = image.repeat(1, 7, 1, 1)[:, :channels].contiguous(memory_format=torch.channels_last)
        weight = torch.ones(13, 4 + channels, 3, 3)
        yield "convolve", convolve(x, weight[:, 4:], torch.zeros(13), mixed(weight[:, 4:]))
        if not (H % 2 or W % 2):
            below = x.repeat(1, 2, 1, 1)[:, :4, ::2, ::2].contiguous(memory_format=torch.channels_last)
            yield "convolve below", convolve(x, weight, torch.zeros(13), mixed(weight, 4), below)
    for channels, dtype in ((32, torch.float32), (48, torch.bfloat16), (32, torch.bfloat16)):
        x = image.repeat(1, 16, 1, 1)[:, :channels].to(dtype).contiguous(memory_format=torch.channels_last)
        yield "to_planes", to_planes(x, torch.ones(3, channels, 3, 3, dtype=dtype), torch.zeros(3))


def _wide(image):
    """Of twice the size: every pixel as 2×2."""
    return image.repeat_interleave(2, 2).repeat_interleave(2, 3)


def _gradients(op, *inputs):
    import torch

    inputs = [tensor.clone().requires_grad_() for tensor in inputs]
    with torch.enable_grad():
        op(*inputs).sum().backward()
    return [tensor.grad for tensor in inputs]


def _image(channels: int, H: int, W: int, kind: str):
    import torch

    image = torch.rand(1, channels, H, W)
    if kind == "NaN":
        image[torch.rand_like(image) < 0.2] = float("nan")
    elif kind == "denormal":
        image *= 1e-40
    elif kind == "zero":
        image.zero_()
    elif kind == "bright":
        image *= 1e15
    return image


def _motion(H: int, W: int, kind: str):
    import torch

    motion = torch.randn(1, 2, H, W) * 3
    values = {"motion 1e4": (1e4, -1e4), "motion NaN": (float("nan"), 0.5), "NaN": (float("nan"), 1e-40),
              "motion Inf": (float("inf"), -float("inf")), "motion 1e30": (1e30, -3e38)}.get(kind)  # fmt: skip
    if values:
        chosen = torch.rand_like(motion)
        motion[chosen < 0.4], motion[chosen > 0.6] = values
    return motion


def _logits(count: int, H: int, W: int, kind: str):
    import torch

    logits = torch.randn(1, count, H, W) * 5
    if kind == "bright":
        logits = torch.where(logits > 0, 1e4, -1e4)  # a single tap, or all alike
    elif kind == "NaN":
        logits[torch.rand_like(logits) < 0.05] = float("nan")
    return logits


def main(sizes: list[str], few: bool) -> None:
    import torch

    from rtdenoise import ops
    from rtdenoise.ops.native import compiler

    del os.environ["LD_PRELOAD"]  # compilers take three times as long with it
    torch.manual_seed(0)
    with ops.use("fused"), torch.no_grad():
        for H, W in (map(int, size.split("x")) for size in sizes):
            compiler.FLAGS = ("-O0" if H * W <= SMALL else "-O1", *SANITIZERS)
            compiler.library.cache_clear()
            print(json.dumps(attack(H, W, few)), flush=True)


if __name__ == "__main__":
    if os.environ.get("UNDER_SANITIZERS"):
        main([word for word in sys.argv[1:] if word != "--few"], "--few" in sys.argv)
    else:
        result = start(*sys.argv[1:])
        print(result.stdout, result.stderr[-4000:], sep="")
        sys.exit(result.returncode)
