"""The fused ops that look pixels up elsewhere, in other frames or in kept ones, against the plain ones: as
`test_ops_fused.py`."""

import functools
import math

import pytest
import torch
from fused_cases import CASES, SIZES
from torch.nn import functional as F

from rtdenoise import ops
from rtdenoise.frame import OFF_SCREEN, Frame, History
from rtdenoise.ops.keep import keep
from rtdenoise.ops.off_pixel import off_pixel
from rtdenoise.ops.over import over, over_and_coverage
from rtdenoise.ops.recall import recall
from rtdenoise.ops.scattered import scattered
from rtdenoise.ops.unlike import unlike
from rtdenoise.shift.displacement import compressed, displacement, displacement_sums
from rtdenoise.shift.light import light_shift, one_surface
from rtdenoise.shift.picture import find, moved
from rtdenoise.splat import history_motion


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


@pytest.mark.parametrize("size", [(1, 1), (17, 5), (24, 139)], ids=str)
def test_unlike(both, size):
    motion = torch.floor(3 * torch.randn(2, 2, *size)) + 0.25
    motion[0, :, 0, 0], motion[1] = math.nan, 0.25
    here, there = (
        (2 * torch.rand(2, 1, *size).round(), torch.randn(2, 3, *size) + torch.tensor([0, 0, 3.0])[:, None, None])
        for _ in range(2)
    )
    plain, fused = both(unlike, *here, motion, *there)
    assert torch.equal(plain, fused) and plain.shape == (2, 3)
    assert min(size) == 1 or ((plain > 0).all() and (plain[:, 1] < plain[:, 0]).all())


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
        light[..., : size[0] // 2, :] **= 0.1  # little noise, and shadows
        shadows = F.interpolate(torch.rand(2, 1, *(-(-n // 5) for n in size)), scale_factor=5)
        light *= 1 - 0.3 * shadows[..., : size[0], : size[1]]
        depth = 1 + 0.1 * torch.rand(2, 1, *size) - 2 * (torch.rand(2, 1, *size) < 0.1).float()
        depth += 2 * (torch.rand(2, 1, *size) < 0.05).float()  # hit here and there
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
    cases.append((recent, uncovered, misplaced[1:], scattered(depth)))  # of all pictures
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


@pytest.mark.parametrize("backend", ["native", "triton"], indirect=True)
def test_differences_that_are_not_white(both, assert_images_close):
    """Shadows of some pixels that have moved: light and dark cancel in a cell and those around."""
    size = 23, 43
    light = 1 - 0.05 * F.interpolate(torch.rand(2, 1, 1, 5, 9).round().flatten(0, 1), scale_factor=5)[..., :23, :43]
    light = light + 0.1 * torch.rand(2, 3, *size)
    depth, normal = torch.ones(1, 1, *size), torch.tensor([0, 0, 1.0])[:, None, None].expand(1, 3, *size)
    motion, reset = torch.zeros(1, 2, *size), torch.zeros(1, 1, *size)
    before, now = light.split(1)
    (_, count), (_, fused) = both(
        lambda *f: tuple(vars(recall(f[0], f[1], f[2:4], (keep(f[4], f[2], f[3], f[5], f[1]),))).values())[:2],
        now, motion, depth, normal, before, reset,
    )  # fmt: skip
    assert_images_close(fused, count, "float32 quotient")
    assert ((count > 0.01) & (count < 0.99)).float().mean() > 0.05  # neither wholly the same nor another


@pytest.mark.parametrize("backend", ["triton"], indirect=True)
def test_lookups_off_the_pixel_by_noise(both, assert_images_close):
    noise = torch.tensor([0.0, 1e-9, 0.01, 0.25, 0.3, 8.0, math.inf]).view(-1, 1, 1, 1)
    for more in (False, True):
        plain, fused = both(functools.partial(off_pixel, more=more), noise)
        assert_images_close(fused, plain, "float32")
        assert plain[0] > 1e5 and not plain[3:].any()
    assert (plain[:3] < off_pixel(noise)[:3]).all()


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
def test_tested_reprojection(both, assert_images_close, size):
    normal, depth, motion = torch.randn(2, 3, *size), 1 + 0.3 * torch.rand(2, 1, *size), 3 * torch.randn(2, 2, *size)
    depth[torch.rand_like(depth) < 0.2] = 0
    motion[0, :, 0, 0], motion[1, :, -1, -1] = math.nan, -math.inf
    before = depth + 0.05 * torch.randn_like(depth) * (depth > 0), normal + 0.5 * torch.randn_like(normal)
    plain, fused = both(ops.reproject, torch.randn(2, 7, *size), motion, (depth, normal), before)
    assert torch.equal(plain[1], fused[1])
    assert_images_close(fused[0], plain[0], "float32 quotient")


@pytest.mark.parametrize("backend, size", CASES, indirect=["backend"], ids=str)
def test_tested_reprojection_of_what_is_not_finite(both, assert_images_close, size):
    """Taps without weight are not read: what they hold does not reach other surfaces."""
    normal, depth, motion = torch.ones(2, 3, *size), 1 + 0.3 * torch.rand(2, 1, *size), 3 * torch.randn(2, 2, *size)
    motion[0] = motion[0].round()
    stored = torch.randn(2, 4, *size).where(depth < 1.25, math.inf)
    plain, fused = both(ops.reproject, stored, motion, (depth, normal), (depth, normal))
    assert torch.equal(plain[0].isfinite(), fused[0].isfinite())
    assert_images_close(fused[0].nan_to_num(posinf=0), plain[0].nan_to_num(posinf=0), "float32 quotient")


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
