"""The fused ops against the plain ones, which are the specification: every size, dtype and layout, extreme logits,
gradients. The CUDA ops run on a GPU if there is one, else in Triton's interpreter."""

import ctypes
import functools
import importlib
import math
from pathlib import Path

import pytest
import torch
from fused_cases import CASES, DTYPES, SIZES

from rtdenoise import ops
from rtdenoise.ops import native, pixels, ranks
from rtdenoise.ops.agrees import agrees
from rtdenoise.ops.around import expand_within
from rtdenoise.ops.blend_history import blend_history
from rtdenoise.ops.block_luminance import block_luminance
from rtdenoise.ops.convolve import convolve, mixed
from rtdenoise.ops.convolve_bytes import convolve_bytes, packed
from rtdenoise.ops.dim import dim
from rtdenoise.ops.even_sky import even_sky
from rtdenoise.ops.evened import evened, held_and_tells
from rtdenoise.ops.feature_bytes import feature_bytes
from rtdenoise.ops.features import features
from rtdenoise.ops.fireflies import without_fireflies
from rtdenoise.ops.lift import lift, lower
from rtdenoise.ops.max_pool import max_pool
from rtdenoise.ops.mean_distance import mean_distance
from rtdenoise.ops.mix import mix
from rtdenoise.ops.native import compiler
from rtdenoise.ops.native.convolve_bytes import BYTES, PAIRS
from rtdenoise.ops.relit import gain, relit_
from rtdenoise.ops.replace_invalid import replace_invalid
from rtdenoise.ops.scattered import scattered
from rtdenoise.ops.settle import settle
from rtdenoise.ops.shares import shares
from rtdenoise.ops.to_bytes import to_bytes
from rtdenoise.ops.to_planes import to_planes
from rtdenoise.ops.turned import turned
from rtdenoise.ops.window_noise import window_noise
from rtdenoise.sanitise import VALID

SHAPE = """
#include "common.h"
#include "tiles.h"
void begin(void) { if (tiles_allowed()) tiles_begin(); }
void end(uint8_t *shape) {
    __asm__ volatile("sttilecfg (%0)" : : "r"(shape) : "memory");
    tiles_end();
}
"""
NARROW = [("native", size) for size in [(1, 5), (4, 1)]]
KERNELS = [(*case, K, dtype) for case in CASES for K in (3, 5) for dtype in DTYPES if K == 3 or case[0] == "native"]


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
    "mostly black": lambda: (1 + torch.rand(2, 300)) * (torch.rand(2, 300) < torch.tensor([[0.02], [0.4]])),
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


@pytest.mark.parametrize("backend", ["native", "triton"], indirect=True)
@pytest.mark.parametrize("size", [(1, 1), (4, 139)], ids=str)
@pytest.mark.parametrize("usual", [(0.5, 0.0), (1e-9, 2.0)])
def test_bright_pixels_are_dimmed_alike(both, assert_images_close, backend, size, usual):
    radiance = torch.rand(2, 3, *size).pow(20)
    radiance[:, :, ::2, ::5] = 1e15
    plain, fused = both(dim, radiance, torch.tensor(usual).view(2, 1), 5.0)
    assert_images_close(fused, plain, "float32")
    assert torch.equal(fused, plain) or backend[0] == "native"  # where C multiplies and adds at once
    assert min(size) == 1 or not torch.equal(plain, radiance)


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_fireflies_are_found_alike(both, assert_images_close, size):
    light, normal = torch.rand(2, 3, *size).pow(9), torch.rand(2, 3, *size) - 0.2
    depth = 5 + (torch.rand(2, 1, *size) < 0.3) - 5.0 * (torch.rand(2, 1, *size) < 0.1)
    plain, fused = both(without_fireflies, light, depth, normal, torch.rand(2, 1, *size))
    assert_images_close(fused, plain, "float32")
    assert torch.equal(fused != light, plain != light)
    assert min(size) < 9 or 0.02 < (plain != light).float().mean() < 0.5


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
    plain, fused = both(expand_within, torch.rand(2, 3, *size) * 9, first, other)
    assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("backend, size", CASES[:-1], indirect=["backend"], ids=str)
def test_dark_light_is_lifted_alike(both, size):
    light = 10 ** (10 * torch.rand(2, 3, *size) - 7)
    for op in (lift, lower):
        plain, fused = both(op, light)
        scale = plain.amax(1, keepdim=True) if op is lower else plain  # what is left without grey is a difference
        torch.testing.assert_close(fused / scale, plain / scale, rtol=5e-6, atol=1e-6 if op is lower else 0)


@pytest.mark.parametrize("backend, size", CASES[:-1], indirect=["backend"], ids=str)
def test_turns_are_found_alike(both, assert_images_close, size):
    """A surface that turns, one whose normals are noise, and pixels without a normal in either frame."""
    normal = torch.randn(2, 3, *size) + torch.tensor([0.0, 0.0, 9.0]).view(3, 1, 1)
    before = normal + torch.rand(2, 1, 1, 1) * torch.tensor([2.0, 0.0, 0.0]).view(3, 1, 1)
    before[1] += torch.randn(3, *size)
    for image in (normal, before):
        image *= (torch.rand(2, 1, *size) < 0.9) * torch.rand(2, 1, *size)
    plain, fused = both(turned, normal, before)
    assert_images_close(fused, plain, "float32 quotient")
    assert plain.any() or min(size) < 3


@pytest.mark.parametrize("backend, size", CASES[:-1], indirect=["backend"], ids=str)
def test_running_means_are_tested_alike(both, assert_images_close, size):
    """Where light has changed a little or much, is as it was, and where there is no mean."""
    light = torch.rand(2, 3, *size)
    mean = light + torch.randn(2, 3, *size) * 0.3 + torch.linspace(0, 0.3, size[1])
    mean[1, ..., size[1] // 2 :] = light[1, ..., size[1] // 2 :]
    plain, fused = both(agrees, light, mean, torch.rand(2, 1, *size) < 0.9)
    assert_images_close(fused, plain, "float32 quotient")


@pytest.mark.parametrize("size, scale", [((3, 4), 1.0), ((1, 141), 1e-20), ((37, 60), 1e15)], ids=str)
@pytest.mark.parametrize("backend", ["native", "triton"], indirect=True)
def test_light_is_as_bright_as_now_alike(both, assert_images_close, size, scale):
    """Light that has become brighter on one side, in one colour by more than is followed, and dark with noise on the
    other; squares of the brightest are infinite."""
    before = scale * torch.rand(2, 3, *size) ** 3
    now = before.flip(0).roll(1, 3)
    now[..., : size[1] // 2] *= torch.tensor([9.0, 1.3, 1.0]).view(3, 1, 1)
    found = torch.rand(2, 1, *size) < 0.9
    plain, fused = both(gain, before, now, found)
    assert_images_close(fused, plain, "float32 quotient")
    assert plain.amax() > 1.1 or size[0] < 37
    image = torch.rand(2, 5, *size)
    image, light = both(lambda gain: relit_(image.clone(), gain), plain)
    torch.testing.assert_close(light, image)


@pytest.mark.parametrize("size", [(3, 4), (17, 5), (1, 150)], ids=str)
@pytest.mark.parametrize("backend", ["native", "triton"], indirect=True)
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
@pytest.mark.parametrize("backend", ["native"], indirect=True)
def test_pictures_are_settled_alike(both, assert_images_close, size):
    image = 5 * torch.rand(2, 3, *size)
    following, noisy = ((image + spread * torch.randn_like(image)).clamp(min=0) for spread in (0.3, 2.0))
    same, trusted = (torch.rand(2, 1, *size) for _ in range(2))
    same[:, :, : size[0] // 2 + 1, : size[1] // 2] = 0
    plain, fused = both(settle, image, following, noisy, same, trusted, torch.tensor([0.3, 7.0]).view(2, 1, 1, 1))
    assert_images_close(fused, plain, "float32")
    other = (same == 0).expand_as(image)
    assert torch.equal(fused[other], image[other]) and not torch.equal(fused, image)


@pytest.mark.parametrize("size", [(3, 4), (17, 5), (1, 150)], ids=str)
@pytest.mark.parametrize("backend", ["native", "triton"], indirect=True)
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
    depth = 5.0 * (torch.rand(2, 1, *size) < 0.1)
    pictures = first, other, torch.tensor([0.01, 30.0]).view(2, 1, 1, 1), trust, (0.4, 0.1, 0.1), *more
    for last in ((), (depth,), (depth, torch.tensor([0.0, 0.3]).view(2, 1, 1, 1))):
        plain, fused = both(mix, *pictures, *last)
        assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_values_within_limits(both, size):
    limits = (float(torch.tensor(-0.3)), 1e9)  # -0.3 is no float32 number
    for value, expected in ((1e9, True), (limits[0], True), (-0.31, False), (math.nan, False), (math.inf, False)):
        values = torch.rand(2, 3, *size)
        values[1, 2, -1, -1] = value
        assert both(pixels.within, values, *limits) == (expected, expected), value


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


PLANES = [case for case in CASES if case != ("triton", (3, 4))] + [*NARROW, ("triton", (5, 4))]  # 5: two strips


@pytest.mark.parametrize("backend, size", PLANES, indirect=["backend"], ids=str)
@pytest.mark.parametrize("dtypes", [("float32", "float32"), ("bfloat16", "bfloat16"), ("bfloat16", "float32")], ids=str)
@pytest.mark.parametrize(("channels", "planes"), [(32, 3), (48, 1), (16, 4), (64, 2)])
def test_to_planes(both, backend, assert_images_close, monkeypatch, size, dtypes, channels, planes):
    """In the interpreter strips are of four rows: it takes its time for those beyond the picture, too."""
    if backend == ("triton", "cpu"):
        monkeypatch.setattr(importlib.import_module("rtdenoise.ops.triton.to_planes"), "ROWS", 4)
    of_x, of_weights = (getattr(torch, name) for name in dtypes)
    x = torch.rand(2, channels, *size).to(of_x).to(memory_format=torch.channels_last)
    weight, bias = torch.rand(planes, channels, 3, 3).to(of_weights), torch.rand(planes).to(of_weights)
    plain, fused = both(lambda *given: to_planes(*given), x, weight, bias)
    assert plain.shape == (2, planes, *size) and plain.dtype == fused.dtype == torch.float32
    assert_images_close(fused, plain, "float32")


@pytest.mark.parametrize(
    ("channels", "planes", "size"), [(32, 3, (4, 40)), (64, 1, (1, 34)), (96, 4, (3, 18))], ids=str
)
def test_to_planes_with_tiles(both, monkeypatch, channels, planes, size):
    other = functools.partial(compiler.library, EMULATED=1)
    monkeypatch.setattr("rtdenoise.ops.native.to_planes.library", other)
    x = torch.randn(1, channels, *size).bfloat16().to(memory_format=torch.channels_last)
    weight, bias = torch.randn(planes, channels, 3, 3).bfloat16(), torch.randn(planes).bfloat16()
    plain, fused = both(lambda *given: to_planes(*given), x, weight, bias)
    assert (fused - plain).abs().max() < 1e-5 * plain.abs().max()


def test_registers_of_tiles_have_their_shape(monkeypatch, tmp_path):
    """Also in a function that does nothing else: GCC left out what its instructions do not say that they read."""
    if not torch.cpu._is_amx_tile_supported():
        return
    for name in ("common.h", "tiles.h"):
        (tmp_path / name).write_text((Path(native.__file__).parent / name).read_text(encoding="utf-8"))
    (tmp_path / "shape.c").write_text(SHAPE)
    monkeypatch.setattr(compiler.resources, "files", lambda package: tmp_path)
    found, code = (ctypes.c_uint8 * 64)(), compiler.library("shape")
    code.begin()
    code.end(found)
    assert list(found) == [1, *[0] * 15, *[64, 0] * 8, *[0] * 16, *[16] * 8, *[0] * 8]


def some_bytes(*shape):
    return torch.randint(0, 256, shape, dtype=torch.uint8).to(memory_format=torch.channels_last)


def whole_weights(*shape):
    return torch.randint(-127, 128, shape, dtype=torch.int8)


@pytest.mark.parametrize("size", [*SIZES, (2, 12), (1, 13)], ids=str)
@pytest.mark.parametrize("dtype", [torch.uint8, torch.bfloat16], ids=str)
@pytest.mark.parametrize(("channels", "outputs"), [(16, 32), (48, 112), (20, 12), (128, 33), (256, 33)])
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


OTHER_CPUS = [
    (BYTES, {"LANES": 16}), (BYTES, {"LANES": 8}), (BYTES, {"LANES": 4}),
    (BYTES, {"LANES": 4, "EMULATED": 1}), (BYTES, {"EMULATED": 1}), (PAIRS, {}), (PAIRS, {"LANES": 4}),
]  # fmt: skip


@pytest.fixture
def on_cpu(monkeypatch):
    """Makes `convolve_bytes` take the C of a CPU that multiplies BYTES or PAIRS, with constants."""

    def take(multiplies, **constants):
        of = "rtdenoise.ops.native.convolve_bytes"
        monkeypatch.setattr(f"{of}.multiplies", lambda: multiplies)
        monkeypatch.setattr(f"{of}.library", functools.partial(compiler.library, **constants))

    return take


@pytest.mark.parametrize("multiplies, has", OTHER_CPUS, ids=str)
@pytest.mark.parametrize("dtype", [torch.uint8, torch.bfloat16], ids=str)
@pytest.mark.parametrize(("channels", "outputs"), [(16, 24), (16, 48), (36, 13)])
def test_convolve_bytes_on_other_cpus(both, on_cpu, multiplies, has, dtype, channels, outputs):
    """By vectors of 512 and 256 bits, where this one has their instructions, by none, by tiles, and by Winograd's
    minimal filtering."""
    on_cpu(multiplies, **has)
    x, coarse, bias = some_bytes(1, channels, 4, 70), some_bytes(1, 8, 2, 35), 50 * torch.randn(4, outputs)
    weights = [packed([whole_weights(outputs, 8, 2, 2), whole_weights(outputs, channels, 3, 3)]) for _ in range(4)]
    factor = torch.rand(4, outputs) * 2e-3
    alone = x, packed([whole_weights(outputs, channels, 3, 3)])[None], factor[:1], bias[:1], None
    for arguments in (alone, (x, torch.stack(weights), factor, bias, coarse)):
        plain, fused = both(lambda *tensors: convolve_bytes(*tensors, dtype), *arguments)
        assert torch.equal(plain, fused)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (5, 4), (7, 25)], ids=str)
@pytest.mark.parametrize(("below", "beside", "outputs"), [(4, 4, 4), (20, 256, 33), (112, 48, 40)])
def test_convolve_bytes_by_pairs(both, on_cpu, size, below, beside, outputs):
    """Also of inputs and weights as great as they can be, whose mixtures 16 bits must hold."""
    on_cpu(PAIRS)
    H, W = size
    factor, bias = torch.rand(4, outputs) * 1e-3, 50 * torch.randn(4, outputs)
    for most in (False, True):
        fine, alone = some_bytes(2, beside, 2 * H, 2 * W), some_bytes(2, beside, H, W)
        coarse = some_bytes(2, below, H, W)
        of_fine, of_coarse = whole_weights(outputs, beside, 3, 3), whole_weights(outputs, below, 2, 2)
        if most:
            fine, alone, coarse = (x // 128 * 255 for x in (fine, alone, coarse))
            of_fine, of_coarse = (127 * w.sign() for w in (of_fine, of_coarse))
        phases = packed([of_coarse, of_fine])[None].repeat(4, 1, 1, 1)
        for arguments in ((alone, packed([of_fine])[None], factor[:1], bias[:1]), (fine, phases, factor, bias, coarse)):
            plain, fused = both(convolve_bytes, *arguments)
            assert torch.equal(plain, fused)


@pytest.mark.parametrize("size, channels, outputs", [((1, 1), 9, 32), ((3, 7), 12, 33), ((6, 26), 64, 48)], ids=str)
@pytest.mark.parametrize("has", [{}, {"LANES": 16}, {"LANES": 8}, {"LANES": 4}], ids=str)
def test_convolve(both, monkeypatch, has, size, channels, outputs):
    """Also with the vectors of other CPUs, and beside 10⁶ times as much light, which a window does not see."""
    monkeypatch.setattr("rtdenoise.ops.native.convolve.library", functools.partial(compiler.library, **has))
    H, W = size
    x, fine, coarse = torch.rand(2, channels, H, W), torch.rand(2, channels, 2 * H, 2 * W), torch.rand(2, 20, H, W)
    x, fine, coarse = (y.contiguous(memory_format=torch.channels_last) for y in (x, fine, coarse))
    fine[..., W:] *= 1e6
    weight, bias = torch.randn(outputs, 20 + channels, 3, 3) / channels**0.5, torch.randn(outputs)
    alone = weight[:, 20:]
    plain, fused = both(convolve, x, alone, bias, mixed(alone))
    assert plain.shape == fused.shape == (2, outputs, H, W) and (plain == 0).any() and (plain > 0).any()
    assert (fused - plain).abs().max() < 3e-6 * plain.max()
    plain, fused = both(convolve, fine, weight, bias, mixed(weight, 20), coarse)
    assert plain.shape == fused.shape == (2, outputs, 2 * H, 2 * W)
    for part in (slice(W - 1), slice(W - 1, None)):
        assert not plain[..., part].numel() or (fused - plain)[..., part].abs().max() < 3e-6 * plain[..., part].max()


def test_convolve_falls_back():
    """Of more channels than the fused op holds, and in another layout."""
    for channels, layout in ((300, torch.channels_last), (8, torch.contiguous_format)):
        x, weight = torch.rand(1, channels, 4, 5).contiguous(memory_format=layout), torch.randn(8, channels, 3, 3)
        expected = torch.relu(torch.nn.functional.conv2d(x, weight, torch.ones(8), padding=1))
        assert torch.equal(convolve(x, weight, torch.ones(8), mixed(weight)), expected)


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
    plain, fused = both(feature_bytes, radiance, albedo, normal)
    assert plain.stride() == fused.stride() and (plain.int() - fused.int()).abs().max() <= 1
    assert (plain != fused).float().mean() < 1e-3  # light at the edge of two steps


@pytest.mark.parametrize("backend", ["native", "triton"], indirect=True)
@pytest.mark.parametrize("size", [(2, 2), (4, 90), (6, 10)], ids=str)
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_max_pool(both, size, dtype):
    x = torch.randn(2, 24, *size).to(dtype).to(memory_format=torch.channels_last)
    x[0, 3, 1, 0], x[1, 5, 0, 0], x[1, 6, 0, 1] = math.nan, -math.inf, math.inf
    plain, fused = both(max_pool, x)
    assert fused.dtype == dtype and fused.is_contiguous(memory_format=torch.channels_last)
    assert torch.equal(fused.nan_to_num(7), plain.nan_to_num(7)) and fused[0, 3, 0, 0].isnan()


@pytest.mark.parametrize("size", [(2, 2), (4, 90)], ids=str)
def test_max_pool_of_bytes(both, size):
    plain, fused = both(max_pool, some_bytes(2, 24, *size))
    assert torch.equal(plain, fused) and fused.is_contiguous(memory_format=torch.channels_last)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16], ids=str)
@pytest.mark.parametrize("size", [(1, 1), (5, 7), (24, 12)], ids=str)
def test_to_bytes(both, size, dtype):
    x = (300 * torch.rand(2, 24, *size)).to(dtype).to(memory_format=torch.channels_last)
    x[0, 3, 0, 0], scale = 1e30, torch.rand(24, 1, 1).to(dtype)
    plain, fused = both(to_bytes, x, scale)
    assert plain.stride() == fused.stride() and (plain.int() - fused.int()).abs().max() <= 1
    assert (plain != fused).float().mean() < 1e-3 and fused[0, 3, 0, 0] == 255
    assert torch.equal(*both(to_bytes, x, torch.ones_like(scale)))


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


def test_luminance_of_very_wide_blocks(assert_images_close):
    """Wider than the fused op takes."""
    with ops.use("auto"):
        means, maxima = block_luminance(torch.ones(1, 3, 2, 3000), 2000)
    assert_images_close(means[..., None, None], torch.ones(1, 2, 1, 1), "float32")
    assert_images_close(maxima[..., None, None], torch.ones(1, 2, 1, 1), "float32")


def test_rows_of_a_very_wide_picture():
    """Wider than the fused ops take: rows would not fit on their stacks."""
    depth = torch.zeros(1, 1, 1, 3_000_000)
    light = torch.ones_like(depth).expand(1, 3, -1, -1)
    with ops.use("auto"):
        assert torch.equal(even_sky(0 * light, light, depth), light)
        assert torch.equal(scattered(depth), torch.cat([depth + 1, depth], 1))
        assert torch.equal(without_fireflies(light, depth, light, depth), light)
        assert torch.allclose(mix(light, light, depth[..., :1, :1] + 1, depth, (0.5, 0.0, 0.0), depth=depth), light)
