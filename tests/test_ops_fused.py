"""The fused ops against the plain ones, which are the specification: every size, dtype and layout, extreme logits,
gradients; and the fallback to plain ops. The CUDA ops run on a GPU if there is one, else in Triton's interpreter."""

import contextlib
import functools
import importlib
import logging
import math
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch._subclasses import FakeTensorMode
from torch.autograd import forward_ad

from rtdenoise import ops
from rtdenoise.frame import OFF_SCREEN, Frame, History
from rtdenoise.ops import dispatch, pixels, ranks
from rtdenoise.ops.around import expand_within
from rtdenoise.ops.blend_history import blend_history
from rtdenoise.ops.block_luminance import block_luminance
from rtdenoise.ops.convolve_bytes import convolve_bytes, packed
from rtdenoise.ops.dim import dim
from rtdenoise.ops.even_sky import even_sky
from rtdenoise.ops.evened import evened, held_and_tells
from rtdenoise.ops.feature_bytes import feature_bytes
from rtdenoise.ops.features import features
from rtdenoise.ops.max_pool import FUSED as MAX_POOL
from rtdenoise.ops.max_pool import max_pool
from rtdenoise.ops.mean_distance import mean_distance
from rtdenoise.ops.mix import mix
from rtdenoise.ops.native import compiler
from rtdenoise.ops.off_pixel import off_pixel
from rtdenoise.ops.over import over, over_and_coverage
from rtdenoise.ops.recall import keep, recall
from rtdenoise.ops.replace_invalid import replace_invalid
from rtdenoise.ops.shares import shares
from rtdenoise.ops.soften import soften
from rtdenoise.ops.to_planes import to_planes
from rtdenoise.ops.window_noise import window_noise
from rtdenoise.sanitise import VALID
from rtdenoise.shift.displacement import compressed, displacement, displacement_sums
from rtdenoise.shift.light import light_shift, one_surface
from rtdenoise.shift.picture import find, moved
from rtdenoise.splat import history_motion

SIZES = [(1, 1), (1, 9), (17, 5), (6, 3), (59, 161)]
CASES = [("native", size) for size in SIZES]
CASES += [("triton", size) for size in [(1, 1), (3, 4), (1, 141)]]  # the interpreter takes its time; 141 > BLOCK
NARROW = [("native", size) for size in [(1, 5), (4, 1)]]
DTYPES = (torch.float32, torch.bfloat16, torch.float16)
KERNELS = [(*case, K, dtype) for case in CASES for K in (3, 5) for dtype in DTYPES if K == 3 or case[0] == "native"]


@pytest.fixture
def backend(request):
    """A folder of fused ops, `native` unless the test names another, and the device of its tensors."""
    folder = getattr(request, "param", "native")
    return folder, "cuda" if folder == "triton" and torch.cuda.is_available() else "cpu"


@pytest.fixture
def both(backend, monkeypatch):
    """`both(op, *arguments)`: the results of the plain op and of the fused one."""
    folder, device = backend
    monkeypatch.setattr(dispatch, "backend", lambda _: (folder, None))

    def run(op, *arguments):
        with ops.use("plain"):
            plain = op(*_map(torch.clone, arguments))
        with ops.use("fused"):
            fused = op(*_map(lambda t: t.detach().to(device), arguments))
        return plain, _map(torch.Tensor.cpu, fused)

    return run


def _map(function, value):
    if isinstance(value, tuple):
        return tuple(_map(function, v) for v in value)
    return function(value) if isinstance(value, torch.Tensor) else value


@pytest.mark.parametrize("backend, size, K, dtype", KERNELS, indirect=["backend"], ids=str)
def test_apply_kernel(both, assert_images_close, size, K, dtype):
    image = torch.randn(2, 3, *size)
    for spread, layout in ((1, torch.contiguous_format), (4, torch.channels_last), (1e4, torch.contiguous_format)):
        logits = (spread * torch.randn(2, 2 * K * K + 1, *size)).to(dtype).contiguous(memory_format=layout)
        plain, fused = both(ops.apply_kernel, image, logits[:, K * K : 2 * K * K])  # as a head is split
        assert_images_close(fused, plain, "float32")


BY_CELLS = [(*case, 3) for case in CASES] + [("native", size, 5) for size in [*SIZES, (3, 1281)]]


@pytest.mark.parametrize("backend, size, K", BY_CELLS, indirect=["backend"], ids=str)
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_apply_kernel_by_cells(both, assert_images_close, size, K, dtype):
    cells, image, taps = [-(-n // 2) for n in size], torch.randn(2, 3, *size), K * K
    for spread, layout in ((1, torch.channels_last), (1, torch.contiguous_format), (1e4, torch.channels_last)):
        head = (spread * torch.randn(2, 4 * (taps + 4), *cells)).to(dtype).contiguous(memory_format=layout)
        logits = head.unflatten(1, (2, 2, taps + 4))[:, :, :, 2 : taps + 2]
        plain, fused = both(ops.apply_kernel, image, logits)
        assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("far", [-120.0, -1e3, -1e30, -math.inf])
def test_a_tap_whose_weight_underflows_is_ignored(both, far):
    image, logits = torch.full((1, 3, 9, 70), 1e37), torch.full((1, 25, 9, 70), far)
    image[:, :, 4, 35], logits[:, 12] = 1.0, 0.0
    for result in both(ops.apply_kernel, image, logits):
        assert torch.equal(result[:, :, 4, 35], torch.ones(1, 3))


BLENDED = [(*case, dtype) for case in CASES for dtype in DTYPES if case[0] == "native" or dtype == torch.bfloat16]


@pytest.mark.parametrize("backend, size, dtype", BLENDED, indirect=["backend"], ids=str)
def test_blend_history(both, assert_images_close, size, dtype):
    """Single gaps and gaps in rows, then none, then nothing but gaps."""
    spatial, past, alpha = torch.rand(2, 4, *size), torch.rand(2, 4, *size), torch.rand(2, 1, *size)
    seen = torch.rand(2, 1, *size) < 0.8
    seen[:, :, ::3] = True
    logits = torch.randn(2, 4 * 9, *(-(-n // 2) for n in size)).to(dtype).contiguous(memory_format=torch.channels_last)
    for where in (seen, torch.ones_like(seen), torch.zeros_like(seen)):
        plain, fused = both(blend_history, spatial, past, where, logits.unflatten(1, (2, 2, 9)), alpha)
        assert_images_close(fused, plain, "float32")


def test_logits_by_cells_are_those_of_a_transposed_convolution():
    x, head = torch.randn(2, 6, 3, 4), torch.nn.ConvTranspose2d(6, 9, 2, stride=2)
    cells = torch.einsum("bchw,ckij->bijkhw", x, head.weight) + head.bias[:, None, None]
    image = torch.randn(2, 3, 5, 8)
    expected = ops.apply_kernel(image, head(x)[:, :, :5])
    torch.testing.assert_close(ops.apply_kernel(image, cells), expected)


def test_apply_kernel_reads_every_half_float(both, assert_images_close):
    values = torch.arange(2**16, dtype=torch.int32).to(torch.int16).view(torch.float16)
    values = values[values.isfinite()][:63000].reshape(1, 9, 7, 1000)
    plain, fused = both(ops.apply_kernel, torch.randn(1, 3, 7, 1000), values)
    assert_images_close(fused, plain, "float32")


def cubic(image, motion, *choice):
    return ops.warp(image, motion, *choice, cubic=True)


@pytest.mark.parametrize("op", [ops.warp, cubic, ops.fetch])
@pytest.mark.parametrize("backend, size", CASES, indirect=["backend"], ids=str)
def test_reprojection(both, assert_images_close, op, size):
    motion = 4 * torch.randn(2, 2, *size)
    motion[0, :, 0, 0], motion[1, :, -1, -1] = math.nan, math.inf
    if op is ops.fetch:
        motion = torch.floor(motion) + 0.25  # never half-way, where a rounding decides
    plain, fused = both(op, torch.randn(2, 3, *size), motion)
    assert_images_close(fused, plain, "float32")


def kept(*layers):
    """A kept frame, on the CPU whatever the backend."""
    with ops.use("plain"):
        return keep(*layers)


RECALLED = [("native", size, count) for size in (*SIZES, (23, 600)) for count in (1, 5)]
RECALLED += [("triton", (1, 1), 1), ("triton", (5, 3), 2)]


@pytest.mark.parametrize("backend, size, count", RECALLED, indirect=["backend"], ids=str)
def test_recall(both, backend, assert_images_close, size, count):
    """Paths between, onto and off pixels; surfaces, and light that changes in parts of the picture."""

    def frame():
        motion = 2 * torch.randn(2, 2, *size).round() + 0.25 * torch.randn(2, 2, 1, 1).round()
        motion[0, :, 0, 0], motion[1, :, -1, -1] = math.nan, math.inf
        motion[:, :, :, 300:] = 1.0  # whole blocks move together
        light = torch.empty(2, 3, *size).exponential_() * (1 + 3 * torch.rand(2, 1, 1, size[1]).round())
        depth = 1 + 0.1 * torch.rand(2, 1, *size) - 2 * (torch.rand(2, 1, *size) < 0.1).float()
        normal = torch.randn(2, 3, *size) + torch.tensor([0, 0, 3.0])[:, None, None]
        return light, depth.clamp(min=0), normal, torch.rand(2, 1, *size), motion

    def albedo():
        return torch.rand(2, 3, *size)

    for more in ((), (albedo(),)):
        for plain, fused in zip(*both(lambda *f: (keep(*f),), *frame(), *more), strict=True):
            nan = (plain & 0x7F800000 == 0x7F800000) | (plain & 0x7F80 == 0x7F80)
            assert torch.equal(plain[~nan], fused[~nan])
    recent = tuple(kept(*frame(), albedo()) for _ in range(count))
    light, depth, normal, _, motion = frame()
    uncovered, misplaced = torch.rand(2, 1, *size) < 0.3, torch.tensor([0.0, 9.0]).view(2, 1, 1, 1)
    mixed = kept(*frame()), *recent, kept(*frame())  # as where one network takes another's history
    cases = [(recent,), (mixed,), (recent, uncovered), (recent, uncovered, misplaced)]
    cases.append((recent, uncovered, misplaced[1:]))  # of all pictures
    for frames, *footprints in cases if backend[0] == "native" else cases[1::3] if count > 1 else cases[2:3]:
        plain, fused = both(
            lambda frames, *now: tuple(
                t for t in vars(recall(*now[:2], now[2:4], frames, *now[4:])).values() if t is not None
            ),
            frames, light, motion, depth, normal, *footprints,
        )  # fmt: skip
        pairs = list(zip(plain, fused, strict=True))
        for (mean, fused_mean), (weight, fused_weight) in zip(pairs[::2], pairs[1::2], strict=True):
            assert_images_close(fused_weight, weight, "float32 quotient")
            sure = weight > 1  # dividing by less magnifies rounding
            assert_images_close(fused_mean * sure, mean * sure, "float32 quotient")
            assert weight.any() or min(size) < 4


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
def test_lookups_off_the_pixel_by_noise(both, assert_images_close):
    noise = torch.tensor([0.0, 1e-9, 0.01, 0.25, 0.3, 8.0, math.inf]).view(-1, 1, 1, 1)
    plain, fused = both(off_pixel, noise)
    assert_images_close(fused, plain, "float32")
    assert plain[0] > 1e6 and not plain[3:].any()


@pytest.mark.parametrize("backend, size, count", [*RECALLED, ("triton", (1, 3), 9)], indirect=["backend"], ids=str)
def test_over(both, backend, assert_images_close, size, count):
    """Three distances and the sky, each moving by itself in quarters of a pixel."""

    def frame():
        depth = (4 * torch.rand(2, 1, *size)).floor()
        motion = depth * torch.tensor([1.25, -0.5])[:, None, None] - torch.randint(3, (2, 2, 1, 1))
        motion[0, :, 0, 0], motion[1, :, -1, -1] = math.nan, math.inf
        light, surfaces = torch.empty(2, 3, *size).exponential_(), torch.rand(2, 6, *size)
        return kept(light, depth, surfaces[:, :3], torch.rand(2, 1, *size), motion, surfaces[:, 3:]), motion, depth

    recent = tuple(frame()[0] for _ in range(count))
    (seen, now), (_, motion, depth) = torch.rand(2, 2, 9, *size), frame()
    (plain, coverage), (fused, fused_coverage) = both(over_and_coverage, seen, now, motion, depth, recent)
    assert_images_close(fused, plain, "float32")
    assert_images_close(fused_coverage, coverage, "float32")
    assert min(size) == 1 or not torch.equal(plain, seen)
    if backend[0] == "native":
        assert torch.equal(over(seen, now.split(3, dim=1), motion, depth, recent), fused)


@pytest.mark.parametrize("op", [ops.warp, cubic])
@pytest.mark.parametrize("backend, size", CASES, indirect=["backend"], ids=str)
def test_reprojection_with_a_choice(both, assert_images_close, op, size):
    seen = torch.rand(2, 1, *size) < 0.9
    seen[:, :, ::2] = True  # whole rows
    image, motion, otherwise = (torch.randn(2, c, *size) for c in (3, 2, 3))
    plain, fused = both(op, image, 4 * motion, seen, otherwise)
    assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_reprojection_of_many_channels(both, assert_images_close, size):
    """Hidden states of a network: values, gradients in image and motion, and the choice of other pixels."""
    motion = torch.randn(2, 2, *size).mul(4).floor() + 0.1 + 0.8 * torch.rand(2, 2, *size)  # never next to a kink
    motion[0, :, 0, 0], motion[1, :, -1, -1] = math.nan, 1e6
    grad = torch.randn(2, 12, *size)
    seen, otherwise = torch.rand(2, 1, *size) < 0.9, torch.randn(2, 12, *size)

    def gradients(image, motion):
        image, motion = image.requires_grad_(), motion.requires_grad_()
        found = ops.warp(image, motion, seen, otherwise)
        return found.detach(), *torch.autograd.grad(found, (image, motion), grad)

    plain, fused = both(gradients, torch.randn(2, 12, *size), motion)
    for a, b, terms in zip(fused, plain, (1, 1, 12), strict=True):  # a motion's gradient sums over the channels
        assert_images_close(a / terms, b / terms, "grid_sample")


@pytest.mark.parametrize("op", [ops.warp, cubic])
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_reprojection_gradients(both, assert_images_close, op, size):
    """Gradients in the image; pixels that take `otherwise` contribute none."""
    motion, otherwise, seen = 4 * torch.randn(2, 2, *size), torch.randn(2, 3, *size), torch.rand(2, 1, *size) < 0.9

    def gradient(grad, image):
        image = image.requires_grad_()
        return torch.autograd.grad(op(image, motion, seen, otherwise), image, grad)[0]

    for grad in (torch.randn(2, *size, 3).movedim(3, 1), torch.randn(1, 1, 1, 1).expand(2, 3, *size)):
        plain, fused = both(gradient, grad, torch.randn(2, 3, *size))
        assert_images_close(fused, plain, "float32 gradients")


def test_a_cubic_lookup_of_nan_is_nan(both):
    image = torch.rand(1, 3, 24, 30)
    image[0, :, 10, 10] = torch.nan
    plain, fused = both(cubic, image, torch.full((1, 2, 24, 30), 0.37))
    assert plain.isnan().sum() == 3 * 16 and torch.equal(fused.isnan(), plain.isnan())


def test_equal_pixels_that_clamp_a_cubic_lookup_share_its_gradient(both, assert_images_close):
    """Few distinct values: an overshooting lookup is clamped to several equal pixels at once."""
    grad = torch.nn.functional.pad(torch.randn(2, 3, 15, 18), (1, 2, 1, 2))  # all lookups lie between pixels

    def gradient(image):
        image = image.requires_grad_()
        return torch.autograd.grad(cubic(image, torch.full((2, 2, 18, 21), 0.37)), image, grad)[0]

    plain, fused = both(gradient, torch.randint(0, 3, (2, 3, 18, 21)).float())
    assert_images_close(fused, plain, "float32 gradients")


@pytest.mark.parametrize("backend, size", CASES, indirect=["backend"], ids=str)
def test_tested_reprojection_of_several(both, size):
    """Several images give the same as their concatenation, whatever their layout."""
    images = tuple(torch.randn(2, c, *size).contiguous(memory_format=torch.channels_last) for c in (3, 1, 3))
    surface = 1 + 0.1 * torch.rand(2, 1, *size), torch.ones(2, 3, *size)
    motion = 4 * torch.randn(2, 2, *size)
    for result in zip(
        both(ops.reproject, images, motion, surface, surface),
        both(ops.reproject, torch.cat(images, dim=1), motion, surface, surface),
        strict=True,
    ):
        several, one = result
        assert torch.equal(several[0], one[0]) and torch.equal(several[1], one[1])


@pytest.mark.parametrize("backend, size", [*CASES, ("native", (8, 1100))], indirect=["backend"], ids=str)
def test_luminance_of_blocks(both, backend, assert_images_close, size):
    for block in (8, 5) if backend[0] == "native" else (8, 3, 40):
        plain, fused = both(block_luminance, torch.randn(2, 3, *size), block)
        for a, b in zip(fused, plain, strict=True):
            assert_images_close(a[..., None, None], b[..., None, None], "float32")


RANKED = {  # many alike, of either sign; some NaN; nothing but NaN
    "few": lambda: torch.tensor([[-0.0, 2.0, -3.0, 0.0, 2.0], [1e-40, 1e30, -1e30, 2.0, -2.0]]),
    "some NaN": lambda: torch.where(torch.rand(2, 300) < 0.3, torch.nan, torch.randn(2, 300)),
    "NaN": lambda: torch.full((2, 1), torch.nan),
    "many": lambda: torch.rand(1, 16384 + 9).mul(30).floor() + 0.1,  # more than stay in registers
}


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
@pytest.mark.parametrize("values", RANKED)
def test_statistics_by_rank(both, assert_images_close, values):
    values = RANKED[values]()
    for k in {1, 1 + values.shape[1] // 3}:
        plain, fused = both(ranks.kth_greatest, values, k)
        torch.testing.assert_close(fused, plain, rtol=0, atol=0, equal_nan=True)
    plain, fused = both(ranks.median, values)
    assert torch.equal(fused, plain)
    plain, fused = both(ranks.exposure_of, values)
    assert torch.equal(fused.isnan(), plain.isnan())
    assert_images_close(fused.nan_to_num(), plain.nan_to_num(), "float32")


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
@pytest.mark.parametrize("size", [(1, 1), (4, 139)], ids=str)
@pytest.mark.parametrize("usual", [(0.5, 0.0), (1e-9, 2.0)])
def test_bright_pixels_are_dimmed_alike(both, size, usual):
    radiance = torch.rand(2, 3, *size).pow(20)
    radiance[:, :, ::2, ::5] = 1e15
    plain, fused = both(dim, radiance, torch.tensor(usual).view(2, 1), 5.0)
    assert torch.equal(fused, plain)
    assert min(size) == 1 or not torch.equal(plain, radiance)


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
@pytest.mark.parametrize("size", [(3, 3), (18, 30), (10, 264)], ids=str)
def test_noise_of_windows(both, assert_images_close, size):
    radiance, depth = torch.empty(2, 3, *size).exponential_(), torch.rand(2, 1, *size)
    radiance[1, :, :3, :9], depth[depth < 0.03] = 0.0, 0.0
    plain, fused = both(window_noise, radiance, depth)
    assert torch.equal(fused.isnan(), plain.isnan())
    assert_images_close(fused.nan_to_num(), plain.nan_to_num(), "float32")


SKIES = [("native", size) for size in [*SIZES, (8, 1100)]] + [("triton", size) for size in [(1, 1), (10, 66)]]


@pytest.mark.parametrize("backend, size", SKIES, indirect=["backend"], ids=str)
@pytest.mark.parametrize("hits", [0.0, 0.002, 0.2])
def test_an_even_sky_is_kept_alike(both, size, hits):
    depth = (torch.rand(2, 1, *size) < hits).float()
    radiance = torch.full((2, 3, *size), 0.5) * (1 + (torch.rand(2, 1, *size) < 0.002) * 2e-3)
    depth[0, 0, -1, -1] = 1.0  # else a frame without hits
    plain, fused = both(even_sky, torch.rand(2, 3, *size), radiance, depth)
    assert torch.equal(plain, fused)
    assert min(size) < 17 or hits > 0.1 or (fused == radiance).any()


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
@pytest.mark.parametrize("size", [(1, 1), (9, 930)], ids=str)
def test_mean_distance(both, assert_images_close, size):
    depth = torch.rand(3, 1, *size)
    depth[depth < 0.3], depth[1], depth[2] = 0.0, 0.0, 1e9
    plain, fused = both(mean_distance, depth)
    assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
@pytest.mark.parametrize("size", [(1, 1), (3, 333)], ids=str)
@pytest.mark.parametrize("channels", [dict.fromkeys(VALID, 3) | {"components": 6, "depth": 1, "motion": 2},
                                      {"normal": 3}], ids=str)  # fmt: skip
def test_invalid_values_are_replaced_alike(both, size, channels):
    found = torch.tensor([math.nan, math.inf, -math.inf, 1e9, 999999936.0, 3e38, 1e15, 2e15, 2.0, 2.1, -2.1, 0.0, 0.5])
    layers = [found[torch.randint(len(found), (2, C, *size))] for C in channels.values()]
    plain, fused = both(
        lambda *layers: tuple(replace_invalid(dict(zip(channels, layers, strict=True)), VALID).values()), *layers
    )
    for a, b in zip(fused, plain, strict=True):
        assert torch.equal(a.view(torch.int32), b.view(torch.int32))


@pytest.mark.parametrize("backend, size", CASES[:-1], indirect=["backend"], ids=str)
def test_light_is_expanded_within_what_is_around_alike(both, assert_images_close, size):
    first, other = torch.rand(2, 2, 3, *size).unbind()
    first[0, 1, -1, -1], other[1, 2, 0, 0] = 1e9, 0.0
    compressed, scale = torch.rand(2, 3, *size) * 9, torch.tensor([0.01, 300.0]).view(2, 1, 1, 1)
    plain, fused = both(expand_within, compressed, scale, first, other)
    assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("size", [(3, 4), (17, 5), (1, 150)], ids=str)
@pytest.mark.parametrize("backend", ["triton"], indirect=True)
def test_light_is_evened_alike(both, assert_images_close, size):
    """Of one frame, of one to two, and of many; and where one frame is in all pixels around."""
    light, image = torch.rand(2, 2, 3, *size).unbind()
    count, trust = 1 + 2 * torch.rand(2, 1, *size).square(), torch.rand(2, 1, *size)
    count[:, :, 1:] = count[:, :, 1:].floor()
    count[1] = 1.0
    plain, fused = both(evened, light, count, image, trust)
    assert_images_close(fused, plain, "float32")
    assert torch.equal(fused[1], light[1]) and not torch.equal(fused[0], light[0])


@pytest.mark.parametrize("size", [(3, 4), (17, 5), (1, 150)], ids=str)
@pytest.mark.parametrize("backend", ["triton"], indirect=True)
def test_the_frame_tells_alike(both, assert_images_close, size):
    held = torch.rand(2, 1, *size) < 0.99
    held[1], held[0, 0, -1, -1] = False, True
    for given in (held, held.float() * torch.rand(2, 1, *size)):
        for plain, fused in zip(*both(lambda x: held_and_tells(x, torch.float32), given), strict=True):
            assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("backend, size", CASES[:-1], indirect=["backend"], ids=str)
@pytest.mark.parametrize("has_noisy", [True, False])
@pytest.mark.parametrize("has_before", [True, False])
def test_pictures_are_mixed_alike(both, assert_images_close, size, has_noisy, has_before):
    first, other, noisy, before = torch.rand(4, 2, 3, *size).pow(6).mul(1e4).unbind()
    noisy[0, :, 0, 0], first[1, :, -1, -1] = 1e9, 0.0
    trust, held, tells = torch.rand(3, 2, 1, *size).unbind()
    more = (before, held) if has_before else (None, None)
    more += (noisy, tells) if has_noisy else (None, None)
    plain, fused = both(mix, first, other, torch.tensor([0.01, 30.0]).view(2, 1, 1, 1), trust, (0.4, 0.1, 0.1), *more)
    assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_values_within_limits(both, size):
    limits = (float(torch.tensor(-0.3)), 1e9)  # -0.3 is no float32 number
    for value, expected in ((1e9, True), (limits[0], True), (-0.31, False), (math.nan, False), (math.inf, False)):
        values = torch.rand(2, 3, *size)
        values[1, 2, -1, -1] = value
        assert both(pixels.within, values, *limits) == (expected, expected), value


@pytest.mark.parametrize("shift", [(3.3, -2.6), (-40.25, 1.0), (0.0, 0.0), (0.5, 17.5)])
def test_tested_reprojection_of_pixels_that_move_together(both, assert_images_close, shift):
    """Neighbours that stay neighbours are loaded in a row, but not beyond the screen."""
    size = 40, 161
    motion = torch.tensor(shift).reshape(1, 2, 1, 1).expand(2, 2, *size).contiguous()
    motion[:, :, 20:] += torch.rand(20, 161).round()  # here neighbours part
    normal, depth = torch.randn(2, 3, *size), 1 + 0.3 * torch.rand(2, 1, *size)
    surface = depth, normal
    plain, fused = both(ops.reproject, torch.randn(2, 7, *size), motion, surface, surface)
    assert torch.equal(plain[1], fused[1])
    assert_images_close(fused[0], plain[0], "float32 quotient")


@pytest.mark.parametrize("backend, size", CASES, indirect=["backend"], ids=str)
@pytest.mark.parametrize("kind", ["dual", "traditional"])
def test_history_motion(both, size, kind):
    motion, motion_next, shift = 4 * torch.randn(3, 2, 2, *size)
    motion[0, :, 0, 0], motion[1, :, -1, -1] = OFF_SCREEN, math.nan
    image, depth = torch.zeros(2, 3, *size), torch.ones(2, 1, *size)
    motion = torch.floor(motion) + 0.25  # never half-way
    motion_next[..., ::2] = -motion[..., ::2]  # nothing is uncovered where these agree

    def found(motion, motion_next, *shift):
        image_there, depth_there = image.to(motion.device), depth.to(motion.device)
        frame = Frame(image_there, depth=depth_there, motion=motion)
        return history_motion(frame, History(image_there, motion_next, depth_there, None), kind, *shift)

    for more in ((), (shift,)):
        for plain, fused in zip(*both(found, motion, motion_next, *more), strict=True):
            torch.testing.assert_close(fused, plain, rtol=0, atol=0, equal_nan=True)


SHIFTS = [("native", size) for size in (*SIZES, (20, 2100))] + [("triton", size) for size in ((1, 1), (19, 50))]


@pytest.mark.parametrize("backend, size", SHIFTS, indirect=["backend"], ids=str)
@pytest.mark.parametrize("cell, stride", [(16, 2), (32, 1)])
def test_displacement_sums(both, assert_images_close, size, cell, stride):
    now, before, here, depth = (torch.rand(2, 1, *size) for _ in range(4))
    motion, shift = 4 * torch.randn(2, 2, *size), torch.randn(2, 2, *(-(-n // cell) for n in size))
    motion[0, :, 0, 0], motion[1, :, -1, -1] = OFF_SCREEN, math.nan
    here[here < 0.3], depths = 0.0, [1 + 0.05 * x for x in (depth, torch.rand(2, 1, *size))]
    plain, fused = both(displacement_sums, now, before, motion, shift, here, *depths, cell, stride)
    assert_images_close(fused, plain, "sums")
    assert min(size) < 17 or (plain[:, 0].sum((1, 2)) > 0).all()


@pytest.mark.parametrize("backend, size", SHIFTS, indirect=["backend"], ids=str)
def test_displacement(both, assert_images_close, size):
    before = (0.5 * torch.arange(size[1])).sin() * (0.4 * torch.arange(size[0])).cos()[:, None]
    before = before.expand(2, 1, *size).contiguous()
    now, here = before.roll(1, dims=3) + 0.01 * torch.rand(2, 1, *size), torch.rand(2, 1, *size).round()
    motion, depth = torch.full((2, 2, *size), -0.25), torch.ones(2, 1, *size)
    depth_before = depth + (torch.rand(2, 1, *size) < 0.1)
    both_ways = functools.partial(displacement, cell=16, damping=0.003)
    found = tuple(zip(*both(both_ways, now, before, motion, here, depth, depth_before), strict=True))
    for plain, fused in found:
        assert_images_close(fused, plain, "float32 quotient")
    assert min(size) < 17 or found[0][0][:, 0].median().item() == pytest.approx(-0.75, abs=0.2)


@pytest.mark.parametrize("backend, size", SHIFTS, indirect=["backend"], ids=str)
@pytest.mark.parametrize("blurred", [False, True])
def test_pictures_are_compressed_alike(both, assert_images_close, size, blurred):
    now, before = (10 ** (6 * torch.rand(2, 3, *size) - 5) for _ in range(2))
    now[1] = 0.0
    for plain, fused in zip(*both(compressed, now, before, blurred), strict=True):
        assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
@pytest.mark.parametrize("size", [(1, 1), (11, 141)], ids=str)
def test_one_surface(both, size):
    depth = 1 + 0.06 * torch.rand(2, 1, *size) + (torch.rand(2, 1, *size) < 0.02)
    depth[0, ..., -1], depth[1, :, 0] = 0.0, 0.0
    plain, fused = both(one_surface, depth)
    assert torch.equal(fused, plain)
    assert min(size) < 11 or 0.1 < plain.mean() < 0.9


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
@pytest.mark.parametrize("size", [(1, 1), (12, 72)], ids=str)
def test_light_shift(both, assert_images_close, size):
    """A bright pane without noise, and noise beside it; in one picture another surface cuts it off."""

    def panes(x):
        light = (0.05 * torch.rand(2, 1, *size)).repeat(1, 3, 1, 1)
        light[..., 4:, 9 + x : 45 + x] = torch.tensor([9.0, 8.0, 7.0])[:, None, None]
        light[..., 4:, 23 + x : 31 + x] = 0.5
        return light

    depth, motion = torch.full((2, 1, *size), 4.0), 0.1 * torch.randn(2, 2, *size)
    depth[0, ..., 39:], motion[1, 0] = 9.0, math.nan
    plain, fused = both(light_shift, panes(0), panes(1), motion, depth, depth + 0.1)
    assert_images_close(fused, torch.zeros_like(fused) if plain is None else plain, "float32 quotient")
    assert min(size) < 12 or 0.1 < plain[0, 0].ne(0).float().mean() < 0.9


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
@pytest.mark.parametrize("size, again", [((1, 1), True), ((12, 72), False), ((12, 72), True)], ids=str)
def test_shifts_are_found_alike(both, assert_images_close, size, again):
    """In a picture that moves, and in one of noise."""
    pattern = 1 + (0.5 * torch.arange(size[1])).sin() * (0.4 * torch.arange(size[0])).cos()[:, None]
    picture, depth = (pattern + 0.1 * torch.rand(2, 1, *size)).repeat(1, 3, 1, 1), torch.full((2, 1, *size), 4.0)
    picture[1], before = torch.rand(3, *size), picture.roll(1, dims=3)
    motion = 0.2 * torch.randn(2, 2, *size)
    depth[..., 61:], motion[0, 0, 0], motion[1, 1, :, -1] = 9.0, math.nan, math.inf
    motion[:, :, 8:9, 8:9] = 17.3  # in the middle of a cell
    past = torch.tensor([0.9, 0.0])[:, None, None].expand(2, 2, *(-(-n // 16) for n in size)) if again else None
    results = both(lambda *t: find(*t[:3], History(t[3], None, t[4], None, found=t[5])),
                   picture, motion, depth, before, depth, past)  # fmt: skip
    for plain, fused in zip(*results, strict=True):
        assert_images_close(fused, plain, "float32 quotient")
    assert min(size) < 12 or (results[0][0][0].any() and not results[0][0][1].all())
    assert min(size) < 12 or torch.equal(*results[0]) != again


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
@pytest.mark.parametrize("size", [(1, 1), (12, 72)], ids=str)
def test_shifts_are_taken_on_alike(both, assert_images_close, size):
    depth, motion = torch.full((2, 1, *size), 4.0), 9 * torch.randn(2, 2, *size).floor() + 0.25  # never half-way
    shift = torch.randn(2, 2, *(-(-n // 16) for n in size))
    shift[:, :, :, 1::2], depth[..., 61:], motion[0, 0, 0] = 0.0, 9.0, math.nan
    plain, fused = both(moved, shift, motion, depth)
    assert_images_close(fused, plain, "float32")
    assert min(size) < 12 or 0.1 < plain.ne(0).float().mean() < 0.9


@pytest.mark.parametrize("backend, size", CASES, indirect=["backend"], ids=str)
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16], ids=str)
def test_features(both, backend, assert_images_close, size, dtype):
    light = [10 ** (9 * torch.rand(2, 3, *size) - 6), torch.zeros(2, 1, *size)]
    light[0][:, 0, 0, 0], light[0][:, 1, 0, 0] = 1e-30, 1e36
    guides = [torch.randn(2, 4, *size), torch.rand(2, 1, *size) < 0.5]
    like = torch.empty(4, 9, 3, 3, dtype=dtype).to(memory_format=torch.channels_last)
    scale = torch.tensor([0.3, 70.0]).reshape(2, 1, 1, 1)

    def joined(scale, unit, lanes, *layers):
        return features(layers[:2], layers[2:], scale, like.to(scale.device), unit, lanes)

    cuts = dtype == torch.bfloat16 and backend == ("triton", "cpu")  # Triton's interpreter does not round
    for unit, lanes in ((1.0, 1), (0.0625 if cuts else 0.06145, 8)):
        plain, fused = both(joined, scale, unit, lanes, *light, *guides)
        assert plain.shape[1] == (9 if lanes == 1 else 16) and plain.dtype == fused.dtype == dtype
        assert fused.stride() == plain.stride()
        assert_images_close(fused.float(), plain.float(), "float32" if dtype == torch.float32 else "bfloat16 rounding")
        assert cuts or torch.equal(fused[:, 4:], plain[:, 4:])  # guides are only rounded


@pytest.mark.parametrize("backend, size", CASES[:-1], indirect=["backend"], ids=str)
def test_features_of_several_kinds(both, assert_images_close, size):
    """As the kernels' network reads them, flags among numbers; then light alone, and flags without numbers."""
    like = torch.empty(4, 9, 3, 3).to(memory_format=torch.channels_last)
    light, flag = tuple(torch.rand(2, 3, *size) for _ in range(3)), torch.rand(2, 1, *size) < 0.5
    guides = *(torch.randn(2, channels, *size) for channels in (3, 1)), flag, torch.randn(2, 2, *size)

    def joined(scale, light, guides):
        return features(light, guides, scale, like.to(scale.device))

    for given in (guides, (), (flag,)):
        plain, fused = both(joined, torch.tensor([0.3, 70.0]).reshape(2, 1, 1, 1), light, given)
        assert plain.shape[1] == 9 + sum(x.shape[1] for x in given)
        assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("dtype", [torch.float16, torch.float64], ids=str)
def test_features_of_other_types_are_plain(both, dtype):
    light, like = torch.rand(1, 3, 8, 9), torch.empty(4, 6, 3, 3, dtype=dtype).to(memory_format=torch.channels_last)
    plain, found = both(lambda x: features([x], [x], torch.ones(1, 1, 1, 1), like), light)
    assert found.dtype == dtype and torch.equal(found, plain)


@pytest.mark.parametrize("backend, size", [*CASES, *NARROW], indirect=["backend"], ids=str)
@pytest.mark.parametrize("dtypes", [("float32", "float32"), ("bfloat16", "bfloat16"), ("bfloat16", "float32")], ids=str)
@pytest.mark.parametrize(("channels", "planes"), [(32, 3), (48, 1), (16, 4), (64, 2)])
def test_to_planes(both, backend, assert_images_close, size, dtypes, channels, planes):
    of_x, of_weights = (getattr(torch, name) for name in dtypes)
    x = torch.rand(2, channels, *size).to(of_x).to(memory_format=torch.channels_last)
    weight, bias = torch.rand(planes, channels, 3, 3).to(of_weights), torch.rand(planes).to(of_weights)
    plain, fused = both(lambda *given: to_planes(*given), x, weight, bias)
    assert plain.shape == (2, planes, *size) and plain.dtype == fused.dtype == torch.float32
    assert_images_close(fused, plain, "float32")


def some_bytes(*shape):
    return torch.randint(0, 256, shape, dtype=torch.uint8).to(memory_format=torch.channels_last)


def whole_weights(*shape):
    return torch.randint(-127, 128, shape, dtype=torch.int8)


@pytest.mark.parametrize("size", [*SIZES, (2, 12), (1, 13)], ids=str)
@pytest.mark.parametrize("dtype", [torch.uint8, torch.bfloat16], ids=str)
@pytest.mark.parametrize(("channels", "outputs"), [(16, 32), (48, 112), (20, 12), (128, 33)])
def test_convolve_bytes(both, size, dtype, channels, outputs):
    """Exact sums: the same to the bit."""
    x, weight = some_bytes(2, channels, *size), packed([whole_weights(outputs, channels, 3, 3)])[None]
    factor, bias = torch.rand(1, outputs) * 2e-3, 50 * torch.randn(1, outputs)
    plain, fused = both(lambda *tensors: convolve_bytes(*tensors, dtype=dtype), x, weight, factor, bias)
    assert plain.shape == (2, outputs, *size) and plain.dtype == fused.dtype == dtype
    assert torch.equal(plain, fused) and plain.stride() == fused.stride()


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (17, 5), (24, 12)], ids=str)
@pytest.mark.parametrize("dtype", [torch.uint8, torch.bfloat16], ids=str)
@pytest.mark.parametrize(("below", "beside", "outputs"), [(64, 16, 64), (112, 48, 96), (4, 12, 20)])
def test_convolve_bytes_that_enlarges(both, size, dtype, below, beside, outputs):
    H, W = size
    x, coarse = some_bytes(2, beside, 2 * H, 2 * W), some_bytes(2, below, H, W)
    weights = [packed([whole_weights(outputs, below, 2, 2), whole_weights(outputs, beside, 3, 3)]) for _ in range(4)]
    factor, bias = torch.rand(4, outputs) * 2e-3, 50 * torch.randn(4, outputs)
    plain, fused = both(lambda *tensors: convolve_bytes(*tensors, dtype), x, torch.stack(weights), factor, bias, coarse)
    assert plain.shape == (2, outputs, 2 * H, 2 * W) and torch.equal(plain, fused)


@pytest.mark.parametrize("lanes", [8, 4])
@pytest.mark.parametrize("dtype", [torch.uint8, torch.bfloat16], ids=str)
@pytest.mark.parametrize("outputs", [24, 48, 13])
def test_convolve_bytes_on_other_cpus(both, monkeypatch, lanes, dtype, outputs):
    """With vectors of 256 bits, where this one has their instructions, and without any for products of bytes."""
    less = functools.partial(compiler.library, LANES=lanes)
    monkeypatch.setattr("rtdenoise.ops.native.convolve_bytes.library", less)
    x, coarse, bias = some_bytes(1, 16, 6, 14), some_bytes(1, 8, 3, 7), 50 * torch.randn(4, outputs)
    weights = [packed([whole_weights(outputs, 8, 2, 2), whole_weights(outputs, 16, 3, 3)]) for _ in range(4)]
    factor = torch.rand(4, outputs) * 2e-3
    alone = x, packed([whole_weights(outputs, 16, 3, 3)])[None], factor[:1], bias[:1], None
    for arguments in (alone, (x, torch.stack(weights), factor, bias, coarse)):
        plain, fused = both(lambda *tensors: convolve_bytes(*tensors, dtype), *arguments)
        assert torch.equal(plain, fused)


def test_convolve_bytes_falls_back():
    """Other layouts, and more channels than the fused op holds."""
    x, wide = some_bytes(1, 16, 6, 7), some_bytes(1, 132, 6, 7)
    weight, other = (packed([whole_weights(8, channels, 3, 3)])[None] for channels in (16, 132))
    factor, bias = torch.full((1, 8), 1e-3), torch.zeros(1, 8)
    expected = convolve_bytes(x, weight, factor, bias)
    assert torch.equal(convolve_bytes(x.contiguous(), weight, factor, bias), expected)
    assert convolve_bytes(wide, other, factor, bias).shape == expected.shape


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_feature_bytes(both, size):
    radiance, albedo, normal = torch.rand(2, 3, *size) ** 8 * 1e5, torch.rand(2, 3, *size), torch.randn(2, 3, *size)
    radiance[0, 0, 0, 0], normal[1] = 1e30, normal[1].sign()
    scale = torch.tensor([0.3, 70.0]).reshape(2, 1, 1, 1)
    plain, fused = both(lambda *tensors: feature_bytes(*tensors, scale), radiance, albedo, normal)
    assert plain.stride() == fused.stride() and (plain.int() - fused.int()).abs().max() <= 1
    assert (plain != fused).float().mean() < 1e-3  # light at the edge of two steps


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
@pytest.mark.parametrize("size", [(2, 2), (4, 90), (6, 10)], ids=str)
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_max_pool(both, size, dtype):
    x = torch.randn(2, 24, *size).to(dtype).to(memory_format=torch.channels_last)
    x[0, 3, 1, 0] = math.nan
    plain, fused = both(max_pool, x)
    assert fused.dtype == dtype and fused.is_contiguous(memory_format=torch.channels_last)
    assert torch.equal(fused.nan_to_num(7), plain.nan_to_num(7)) and fused[0, 3, 0, 0].isnan()


def test_to_planes_falls_back():
    """Where the fused op does not fit: other channels, planes and layouts, and in training."""
    x = torch.randn(1, 32, 6, 7).to(memory_format=torch.channels_last)
    weight, bias = torch.randn(3, 32, 3, 3, requires_grad=True), torch.zeros(3)
    to_planes(x, weight, bias).sum().backward()
    assert weight.grad.abs().sum() > 0
    weight = weight.detach()
    expected = to_planes(x, weight, bias)
    six = to_planes(x, weight.repeat(2, 1, 1, 1), bias.repeat(2))
    for planes in (to_planes(x.contiguous(), weight, bias), six[:, :3], six[:, 3:]):
        torch.testing.assert_close(planes, expected, rtol=1e-4, atol=1e-4)
    assert to_planes(x[:, :9], weight[:, :9], bias).shape == expected.shape
    for other in (weight[:, :16], weight.repeat(1, 2, 1, 1), weight[:2]):  # torch says what is wrong; C would read on
        with pytest.raises(RuntimeError, match=r"to have|to be"):
            to_planes(x, other, bias)


@pytest.mark.parametrize("backend, size", [*CASES, ("native", (3, 1281))], indirect=["backend"], ids=str)
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_shares(both, assert_images_close, size, dtype):
    cells = [-(-n // 2) for n in size]
    for spread, layout in ((1, torch.channels_last), (200, torch.channels_last), (1, torch.contiguous_format)):
        head = (spread * torch.randn(2, 12, *cells)).to(dtype).contiguous(memory_format=layout)
        plain, fused = both(lambda logits: shares(logits, size), head.unflatten(1, (2, 2, 3)))
        assert plain.shape == (2, 3, *size) and plain.dtype == torch.float32
        assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("backend, size", [*CASES, ("triton", (5, 141))], indirect=["backend"], ids=str)
def test_pixelwise_ops(both, assert_images_close, size):
    def image(C: int = 3) -> torch.Tensor:
        return torch.rand(2, C, *size)

    hit = (image(1) < 0.7) * image(1)
    for plain, fused in (
        both(pixels.demodulate, image() * 100, image(), hit),
        both(pixels.modulate, image() - 0.3, image(), image(), image(1), hit),
        both(pixels.nearness, hit, torch.tensor([2.0, 1e-12]).reshape(2, 1, 1, 1)),
    ):
        assert_images_close(fused, plain, "float32")
    reset = image(1).round()  # a restart leaves no trace of the mean, however bright it was
    four = image(), image(1), image(), image(1)
    for new, channels in ((image(), 3), ((image(), image(), image(1)), 7), (four[:2], 4), (four, 8)):
        length = (9 * image(1)).floor() * (1 - reset)
        results = both(pixels.accumulate, new, 1e15 * image(channels), length, reset, 15.0)
        for plain, fused in zip(*results, strict=True):
            assert_images_close(fused, plain, "float32")
    frames = [(3 * image(1)).floor() for _ in range(2)]  # none in some pixels
    for plain, fused in zip(*both(pixels.joined, image(9), frames[0], image(9), frames[1]), strict=True):
        assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("backend, size", CASES, indirect=["backend"], ids=str)
def test_tested_reprojection(both, assert_images_close, size):
    normal, depth, motion = torch.randn(2, 3, *size), 1 + 0.3 * torch.rand(2, 1, *size), 3 * torch.randn(2, 2, *size)
    depth[torch.rand_like(depth) < 0.2] = 0
    motion[0, :, 0, 0], motion[1, :, -1, -1] = math.nan, -math.inf
    before = depth + 0.05 * torch.randn_like(depth) * (depth > 0), normal + 0.5 * torch.randn_like(normal)
    plain, fused = both(ops.reproject, torch.randn(2, 7, *size), motion, (depth, normal), before)
    assert torch.equal(plain[1], fused[1])
    assert_images_close(fused[0], plain[0], "float32 quotient")


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_tested_reprojection_gradients(both, assert_images_close, size):
    """Images of several channel counts, one without a gradient; taps on other surfaces get no gradient."""
    normal, depth, motion = torch.randn(2, 3, *size), 1 + 0.3 * torch.rand(2, 1, *size), 3 * torch.randn(2, 2, *size)
    motion[1, :, -1, -1] = math.nan

    def gradients(grad, light, albedo, length):
        light, length = light.requires_grad_(), length.requires_grad_()
        out, _ = ops.reproject((light, albedo, length), motion, (depth, normal), (depth, normal))
        return torch.autograd.grad(out, (light, length), grad)

    stored = [torch.randn(2, c, *size) for c in (3, 3, 1)]
    for grad in (torch.randn(2, *size, 7).movedim(3, 1), torch.randn(1, 1, 1, 1).expand(2, 7, *size)):
        plain, fused = both(gradients, grad, *stored)
        for a, b in zip(fused, plain, strict=True):
            assert_images_close(a, b, "float32 gradients")


@pytest.mark.parametrize("backend, size", CASES, indirect=["backend"], ids=str)
@pytest.mark.parametrize("pool", ["mean", "max"])
def test_pyramid(both, assert_images_close, size, pool):
    coarse = [-(-n // 2) for n in size]
    fine, alpha = torch.randn(2, 3, *size), torch.rand(2, 1, *coarse)
    for plain, fused in (
        both(ops.downsample, fine, pool),
        both(ops.compose, fine, torch.randn(2, 3, *coarse), alpha, pool),
        both(ops.soften, torch.randn(2, 3, *size), fine, torch.rand(2, 1, *size)),
    ):
        assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("kernel", [3, 5])
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_pick(both, assert_images_close, size, kernel, dtype):
    cells = [-(-n // 2) for n in size]
    fine, coarse, share = torch.randn(2, 3, *size), torch.randn(2, 3, *cells), torch.rand(2, 1, *size)
    for spread in (4, 1e4):
        planes = (spread * torch.randn(2, kernel**2, *size)).to(dtype)
        last = planes.new_empty(2, *size, kernel**2 + 1).movedim(3, 1)[:, 1:].copy_(planes)  # rows of a head
        by_cells = (spread * torch.randn(2, *cells, 2, 2, kernel**2)).to(dtype).permute(0, 3, 4, 5, 1, 2)
        for logits in (planes, last, by_cells, by_cells.contiguous()):
            plain, fused = both(ops.pick, fine, coarse, logits, share)
            assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
def test_pick_where_only_apply_kernel_is_fused(both, assert_images_close):
    logits = torch.randn(2, 2, 2, 9, 2, 3)
    plain, fused = both(
        ops.pick, torch.randn(2, 3, 3, 5), torch.randn(2, 3, 2, 3), logits.bfloat16(), torch.rand(2, 1, 3, 5)
    )
    assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("by_cells", [False, True])
def test_pick_gradients(assert_images_close, size, by_cells):
    """Gradients pass through the fused `apply_kernel`, as in training."""
    cells = [-(-n // 2) for n in size]
    fine, coarse, share = torch.randn(2, 3, *size), torch.randn(2, 3, *cells), torch.rand(2, 1, *size)
    logits, grad = torch.randn(*((2, 2, 2, 9, *cells) if by_cells else (2, 9, *size))), torch.randn(2, 3, *size)

    def gradients(choice):
        inputs = [t.clone().requires_grad_() for t in (fine, coarse, logits, share)]
        with ops.use(choice):
            return torch.autograd.grad(ops.pick(*inputs), inputs, grad)

    for fused, plain in zip(gradients("auto"), gradients("plain"), strict=True):
        assert_images_close(fused, plain, "float32 gradients")


@pytest.mark.parametrize("backend, size", CASES, indirect=["backend"], ids=str)
@pytest.mark.parametrize("spread", [1, 1e4])
def test_apply_kernel_gradients(both, assert_images_close, size, spread):
    grad = torch.randn(2, 3, *size)

    def gradients(image, logits):
        image, logits = image.requires_grad_(), logits.requires_grad_()
        return torch.autograd.grad(ops.apply_kernel(image, logits), (image, logits), grad.to(image))

    plain, fused = both(gradients, torch.randn(2, 3, *size), spread * torch.randn(2, 25, *size))
    assert_images_close(fused[0], plain[0], "float32 gradients")
    assert_images_close(fused[1], plain[1], "float32 gradients")


def test_an_odd_picture_of_full_size(assert_images_close):
    image, logits = torch.rand(1, 3, 719, 1281), torch.randn(1, 25, 719, 1281)
    with ops.use("plain"):
        plain = ops.apply_kernel(image, logits)
    with ops.use("fused"):
        assert_images_close(ops.apply_kernel(image, logits), plain, "float32")


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
    device = {"common", "pool", "targets", "alike", "path", "curve", "cells", "luminance", "first_use"}
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
    # apply_kernel.c blends; convolve_bytes.py asks multiplies_bytes.c
    assert sources == files["native"] - {*shared, "blend_history"} | {"multiplies_bytes"}


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

    monkeypatch.setattr(importlib.import_module("rtdenoise.ops.triton.common"), "prepare", fails)
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


def test_luminance_of_very_wide_blocks(assert_images_close):
    """Wider than the fused op takes."""
    with ops.use("auto"):
        means, maxima = block_luminance(torch.ones(1, 3, 2, 3000), 2000)
    assert_images_close(means[..., None, None], torch.ones(1, 2, 1, 1), "float32")
    assert_images_close(maxima[..., None, None], torch.ones(1, 2, 1, 1), "float32")


def test_an_even_sky_of_a_very_wide_picture():
    """Wider than the fused op takes: rows would not fit on its stack."""
    depth = torch.zeros(1, 1, 1, 3_000_000)
    light = torch.ones_like(depth).expand(1, 3, -1, -1)
    with ops.use("auto"):
        assert torch.equal(even_sky(0 * light, light, depth), light)


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
        "even_sky": (lambda image, light, depth: even_sky(image, light, depth - 0.5), (3, 3, 1)),
        "keep": (keep, (3, 1, 3, 1, 2, 3)),
        "recall": (looked_up, (3, 2, 1, 3)),
        "history_motion": (chosen, (2, 2)),
        "mix": (lambda a, b, trust, c, held: mix(a, b, scale, trust, (0.4, 0.1, 0.1), c, held), (3, 3, 1, 3, 1)),
        "soften": (soften, (3, 3, 1)),
        "blend_history": (filtered, (3, 3, 1)),
        "expand_within": (lambda x, first, other: expand_within(x, scale, first, other), (3, 3, 3)),
        "displacement_sums": (sums, (1, 1, 2, 1, 1, 1)),
        "block_luminance": (lambda x: torch.stack(block_luminance(x, 4)), (3,)),
        "feature_bytes": (lambda *layers: feature_bytes(*layers, scale), (3, 3, 3)),
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
