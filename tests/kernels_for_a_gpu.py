"""Compile every Triton kernel for a GPU. Run in a process of its own, without TRITON_INTERPRET."""

import re

import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource

from rtdenoise.ops.triton import agrees, displacement_sums, even_sky, light_shift, mean_distance, relit
from rtdenoise.ops.triton.apply_kernel import _backward, _forward
from rtdenoise.ops.triton.around import _bounds, _within
from rtdenoise.ops.triton.blend_history import _blend_history
from rtdenoise.ops.triton.block_luminance import _block_luminance
from rtdenoise.ops.triton.compose import _compose
from rtdenoise.ops.triton.compressed import _compressed
from rtdenoise.ops.triton.dim import _dim
from rtdenoise.ops.triton.downsample import _downsample
from rtdenoise.ops.triton.evened import _evened, _greatest, _tells
from rtdenoise.ops.triton.features import _features
from rtdenoise.ops.triton.fetch import _fetch
from rtdenoise.ops.triton.fireflies import _without_fireflies
from rtdenoise.ops.triton.history_motion import _history_motion
from rtdenoise.ops.triton.keep import _keep
from rtdenoise.ops.triton.lift import _lift, _lower
from rtdenoise.ops.triton.max_pool import _max_pool
from rtdenoise.ops.triton.mix import _mix, _told
from rtdenoise.ops.triton.off_pixel import _off_pixel
from rtdenoise.ops.triton.over import _over
from rtdenoise.ops.triton.picture import _counts, _moved
from rtdenoise.ops.triton.pixels import _accumulate, _demodulate, _joined, _modulate, _nearness
from rtdenoise.ops.triton.ranks import _exposure_of, _kth_greatest, _median
from rtdenoise.ops.triton.recall import _compare, _sum
from rtdenoise.ops.triton.replace_invalid import LAYERS, _replace
from rtdenoise.ops.triton.reproject import _reproject
from rtdenoise.ops.triton.shares import _shares
from rtdenoise.ops.triton.soften import _soften
from rtdenoise.ops.triton.to_planes import _to_planes
from rtdenoise.ops.triton.turned import _gives_way, _turns
from rtdenoise.ops.triton.unchanged import _stays
from rtdenoise.ops.triton.warp import _warp
from rtdenoise.ops.triton.window_noise import _window_noise


def build(kernel, constants, **types):
    names = kernel.arg_names
    signature = {n: "constexpr" if n in constants else types.get(n, "*fp32") for n in names}
    source = ASTSource(kernel, signature, {(names.index(n),): v for n, v in constants.items()})
    compiled = triton.compile(source, target=GPUTarget("cuda", 80, 32))
    assert compiled.asm["ptx"], kernel
    assert not re.search("muli %stride, .*: i32", compiled.asm["ttir"])  # all logits may be more than 2³¹ values

build(_max_pool, dict(RUN=1024), x="*bf16", out="*bf16", w="i32", C="i32")
strides = dict(batch="i64", stride="i32", cell_row="i64", row="i64", cell="i32", step="i32")
C = dict(C=3, CP=4, BLOCK=128)
for one in ({}, dict(H=1, W=1)):  # an argument of 1 becomes a constant
    sizes = {n: "i32" for n in "HW" if n not in one}
    build(_forward, dict(K=3, KEEP=True, **C, **one), logits="*bf16", **sizes, **strides)
    build(_backward, dict(K=3, **C, **one), **sizes, **strides)
    build(_fetch, dict(C=3, BLOCK=128, **one), **sizes)
    for yes in (False, True):
        build(_warp, dict(CUBIC=yes, CHOICE=yes, C=3, BLOCK=128, **one), seen="*u8", **sizes)
    build(_downsample, dict(MAXIMUM=False, BLOCK=128, **one), **sizes)
    build(_compose, dict(C=3, MAXIMUM=True, BLOCK=128, **one), **sizes)
    build(_soften, dict(C=3, BLOCK=128, **one), **sizes)
    near = dict(depth_tolerance="fp32", normal_tolerance="fp32", **sizes)
    build(_reproject, dict(COUNTS=(3, 1), TOTAL=4, BLOCK=128, MIN_HISTORY_WEIGHT=0.01, FAR_AWAY=1e6, **one),
          stored=("*fp32",) * 2, valid="*u8", **near)
    masks = dict(seen="*u8", uncovered="*u8", threshold="fp32")
    images = dict(B=1, frames=1) if one else {}
    counts = dict(words="i32", step="i32", **dict.fromkeys({"B", "frames"} - {*images}, "i32"))
    tests = dict.fromkeys(["alike", "changed", "wide_alike", "wide_changed", "white", "joined"], "fp32")
    for sums in (4, 5):
        build(_stays, dict(SUMS=sums, BLOCK=128, **{n: v for n, v in {**one, **images}.items() if n in "HWB"}), **sizes,
              **counts, **tests)
    for pointers in (("*i32",) * 8, ("*i64",) * 8):  # of frames, and of their addresses
        counts["recent"] = pointers
        build(_compare, dict(CELL=4, COLUMNS=32, FAR_AWAY=1e6, **one, **images), rounding="fp32", **near, **counts)
        for yes in (False, True):
            build(_sum, dict(CELL=4, FOOTPRINT=yes, MISPLACED=yes, LONE=yes, BLOCK=128, FAR_AWAY=1e6, **one, **images),
                  uncovered="*u8", edge_speed="fp32", gloss="fp32", **near, **counts)
        build(_over, dict(BLOCK=128, FAR_AWAY=1e6, **{n: v for n, v in {**one, **images}.items() if n != "B"}),
              **sizes, **counts, **dict.fromkeys(["apart", "speed", "same", "light", "gloss", "tolerance"], "fp32"))
    build(_off_pixel, dict(BLOCK=128, **({"count": 1} if one else {})), share="fp32", less="fp32", count="i32")
    for first in (False, True):
        build(_keep, dict(WORDS=8, FOOTPRINT=first, BLOCK=128, **one), kept="*i32", edge_speed="fp32", **near)
        for shift in (False, True):
            build(_history_motion, dict(NEXT=first, SHIFT=shift, BLOCK=128, **one), **masks, **sizes)
        numbers = ["usual", "share_before", "lowest", "smallest", "far", "telling_enough", "uncovered"]
        parts = dict.fromkeys(("BEFORE", "TOLD", "SKY"), first)
        build(_mix, dict(CELL=4, BLOCK=128, **parts, **one), **dict.fromkeys(numbers, "fp32"), **sizes)
    build(_bounds, dict(CELL=16, **one), **sizes)
    half = dict.fromkeys(("x", "weight", "bias"), "*bf16")
    steps = dict.fromkeys(["strips", "of_output", "of_input", "of_row", "of_column"], "i32")
    build(_to_planes, dict(C=32, O=3, CHANNELS=32, PRECISION="half", PADDED=16, ROWS=16, BLOCK=128, **one), **half,
          **steps, **sizes)
    build(_within, dict(CELL=16, BLOCK=128, **one), **sizes)
    flat = dict(BLOCK=512, **({"plane": 1} if one else {})), {} if one else {"plane": "i32"}
    build(_demodulate, dict(C=3, **flat[0]), gloss="fp32", **flat[1])
    build(_modulate, dict(C=3, **flat[0]), gloss="fp32", **flat[1])
    build(_accumulate, dict(M=3, N=6, C=9, **flat[0]), most="fp32", same="fp32", **flat[1])
    build(_joined, dict(C=9, **flat[0]), **flat[1])
    build(_nearness, flat[0], **flat[1])
    build(_features, dict(ENDS=(0, 3, 6, 7), FLAGS=(False, False, True), LIGHT=3, ALL=8, CP=8, BLOCK=128,
                          **({"plane": 1} if one else {})),
          images=("*fp32", "*fp32", "*u8"), out="*bf16", unit="fp32", **flat[1])
    build(_blend_history, dict(K=3, C=4, BLOCK=128, **one), logits="*bf16", seen="*u8", **sizes, **strides)
    build(_shares, dict(N=3, BLOCK=128, **one), logits="*bf16", **sizes, **strides)
    cells = dict(CELL=16, BLOCK=128, **one)
    build(_evened, dict(C=3, **cells), share="fp32", **sizes)
    for dtype in ("*fp32", "*u8"):
        build(_greatest, dict(CELL=16, CELLS=8, **one), x=dtype, **sizes)
        build(_tells, cells, held=dtype, **sizes)
    build(_told, dict(CELL=4, BLOCK=128, **one), usual="fp32", dark="fp32", largest="fp32", **sizes)
    build(_turns, dict(CELL=4, BLOCK=128, **one), **sizes)
    build(_gives_way, dict(CELL=4, BLOCK=128, **one), noise="fp32", angle="fp32", **sizes)
    build(agrees._compare, dict(CELL=4, BLOCK=128, **one), found="*u8", rounding="fp32", **sizes)
    build(agrees._spread, dict(CELL=4, BLOCK=128, **one), **sizes)
    build(relit._sum_cells, dict(CELL=4, BLOCK=128, **one), found="*u8", **sizes)
    cells = ({}, dict(h="i32", w="i32")) if not one else (dict(h=1, w=1), {})
    for first, half in ((True, 2), (False, 1)):
        build(relit._sum_quarters, dict(FIRST=first, HALF=half, BLOCK=128, **cells[0]), **cells[1])
    bounds = dict.fromkeys(["rounding", "darker", "start", "whole", "most"], "fp32")
    build(relit._brighter, dict(BLOCK=128, **cells[0]), **cells[1], **bounds)
    build(relit._gain, dict(CELLS=4, BLOCK=128, **cells[0]), **cells[1])
    build(relit._relit, dict(CELL=4, BLOCK=128, **one), C="i32", **sizes)
    build(even_sky._blocks, dict(SIDE=8, COUNT=8, **one), **sizes)
    build(even_sky._even_sky, dict(SIDE=8, COUNT=8, **one), tolerance="fp32", **sizes)
    build(_without_fireflies, dict(LEAST=5, BLOCK=128, **one), **near)
    curve = dict.fromkeys("GABCDEFS", "fp32")
    build(_lift, flat[0], **flat[1], **curve, Y0="fp32", Y1="fp32")
    build(_lower, flat[0], **flat[1], **curve, X0="fp32", X1="fp32")
    build(_dim, dict(BLOCK=128, **one), limit="fp32", **sizes)
    for side, rows, count, wide in ((8, 8, 16, 8), (3, 4, 32, 4)):
        build(_block_luminance, dict(SIDE=side, ROWS=rows, COUNT=count, WIDE=wide, **one), **sizes)
    if not one:
        build(_window_noise, dict(SIDE=3, STEP=8, COUNT=32), **sizes)
    count = dict(N=1) if one else {}
    row = dict(CHUNK=2048, **count)
    build(_kth_greatest, row, N="i32", k="i32")
    build(_exposure_of, row, N="i32", tenths="i32", least="fp32")
    build(_median, row, N="i32")
    build(mean_distance._sums, dict(PART=4096, **count), N="i32")
    build(mean_distance._mean, dict(AT_ONCE=1024, **(dict(parts=1) if one else {})), parts="i32", least="fp32")
    layers = dict(zip((name.upper() for name in LAYERS), (3, 6, 3, 3, 1, 2, 0), strict=False))
    limits = "darkest brightest least_albedo greatest_albedo least_normal greatest_normal far off_screen"
    build(_replace, dict(PIXELS=512, **layers, **count), N="i32", **dict.fromkeys(limits.split(), "fp32"))
    limits = dict(tolerance="fp32", least="fp32", most="fp32")
    blocks, in_cells = dict(SIDE=3, BLOCK=128, **one), {n.lower(): 1 for n in one}
    cells = {n.lower(): "i32" for n in sizes}
    for blurred in (False, True):
        pictures = {} if one else dict(B=1)
        build(_compressed, dict(BLURRED=blurred, ROWS=8, BLOCK=128, **one, **pictures), B="i32", brightness="fp32",
              **sizes)
        build(_counts, dict(BEFORE=blurred, CELL=16, BLOCK=32, **one, **in_cells), **sizes, **cells, **limits,
              **dict.fromkeys(("most_left", "sure", "apart"), "fp32"))
    build(light_shift._blocks, blocks, tolerance="fp32", **sizes)
    build(light_shift._near, blocks, tolerance="fp32", **sizes)
    build(light_shift._beside, dict(AROUND=3, BLOCK=128, **in_cells), **cells)
    build(light_shift._shift, dict(CELL=32, **blocks), **limits, **sizes)
    build(light_shift._surfaces, blocks, tolerance="fp32", **sizes)
    build(_moved, dict(CELL=16, BLOCK=128, **one), **sizes)
    for first, last in ((True, False), (False, True), (True, True)):
        build(displacement_sums._sums, dict(SHIFTED=not first, CELL=16, STRIDE=2, SIDE=8, **one), tolerance="fp32",
              **sizes)
        build(displacement_sums._solve, dict(FIRST=first, LAST=last, AROUND=3, BLOCK=32, **in_cells), damping="fp32",
              enough="fp32", **cells)
