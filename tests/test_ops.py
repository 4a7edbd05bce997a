"""Each op against its index equation: one lit pixel first, then gradients, odd sizes and awkward input."""

import math

import pytest
import torch
from torch.nn import functional as F

from rtdenoise.motion import on_screen
from rtdenoise.ops import apply_kernel, blend, compose, downsample, fetch, pick, reproject, soften, upsample, use, warp
from rtdenoise.ops.logits import cells as cells_of
from rtdenoise.ops.logits import whole


@pytest.fixture(autouse=True, params=["plain", "auto"])
def choice(request):
    """Every test runs with the plain ops and with the fused ones of this machine."""
    with use(request.param):
        yield


SIZES = [(1, 1), (1, 9), (5, 17), (16, 12)]


def impulse(height, width, y, x):
    image = torch.zeros(1, 1, height, width)
    image[0, 0, y, x] = 1
    return image


@pytest.mark.parametrize("tap", range(25))
def test_apply_kernel_gathers_from_the_tap_of_its_equation(tap):
    dy, dx = divmod(tap, 5)
    logits = torch.full((1, 25, 9, 11), -1e4)
    logits[:, tap] = 0
    out = apply_kernel(impulse(9, 11, 4, 6), logits)
    # out[y, x] = image[y + dy - 2, x + dx - 2], so the lit pixel (4, 6) appears at (4 - dy + 2, 6 - dx + 2).
    assert torch.equal(out, impulse(9, 11, 6 - dy, 8 - dx))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("K", [1, 3, 5])
def test_apply_kernel_is_its_index_equation(size, K):
    H, W = size
    image, logits = torch.randn(2, 3, H, W), torch.randn(2, K * K, H, W)
    expected = torch.zeros_like(image)
    for y in range(H):
        for x in range(W):
            taps = [(dy * K + dx, y + dy - K // 2, x + dx - K // 2) for dy in range(K) for dx in range(K)]
            taps = [(k, v, u) for k, v, u in taps if 0 <= v < H and 0 <= u < W]
            weights = logits[:, [k for k, _, _ in taps], y, x].softmax(1)
            expected[:, :, y, x] = sum(weights[:, i : i + 1] * image[:, :, v, u] for i, (_, v, u) in enumerate(taps))
    torch.testing.assert_close(apply_kernel(image, logits), expected)


@pytest.mark.parametrize("fill", [0.0, 1e4, -1e4])
def test_apply_kernel_keeps_a_constant_image_whatever_the_logits(fill):
    logits = torch.full((1, 25, 6, 7), fill)
    logits[:, 3] = -fill
    image = torch.full((1, 3, 6, 7), 0.7)
    torch.testing.assert_close(apply_kernel(image, logits), image)


def test_apply_kernel_ignores_layout_and_half_logits():
    image, logits = torch.rand(1, 3, 8, 9), torch.randn(1, 25, 8, 9)
    expected = apply_kernel(image, logits)
    strided = torch.rand(1, 3, 9, 8).transpose(2, 3).copy_(image)
    torch.testing.assert_close(apply_kernel(strided, logits.to(memory_format=torch.channels_last)), expected)
    assert apply_kernel(image, logits.half()).dtype == torch.float32
    torch.testing.assert_close(apply_kernel(image, logits.half()), expected, atol=2e-3, rtol=2e-3)


def test_apply_kernel_gradients():
    image = torch.randn(1, 2, 4, 5, dtype=torch.float64, requires_grad=True)
    logits = torch.randn(1, 9, 4, 5, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(apply_kernel, (image, logits))


def test_warp_shows_at_p_what_was_at_p_plus_motion():
    motion = torch.zeros(1, 2, 7, 9)
    motion[:, 0], motion[:, 1] = 2, -1
    assert torch.equal(warp(impulse(7, 9, 3, 5), motion), impulse(7, 9, 4, 3))
    assert torch.equal(fetch(impulse(7, 9, 3, 5), motion), impulse(7, 9, 4, 3))


def test_warp_between_pixels_is_bilinear():
    motion = torch.zeros(1, 2, 1, 4)
    motion[:, 0] = 0.25
    out = warp(torch.tensor([0.0, 4.0, 8.0, 8.0]).reshape(1, 1, 1, 4), motion)
    assert out.flatten().tolist() == [1, 5, 8, 8]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("channels", [3, 12])
def test_warp_agrees_with_grid_sample(size, channels):
    H, W = size
    image, motion = torch.randn(2, channels, H, W), 4 * torch.randn(2, 2, H, W)
    y, x = torch.meshgrid(torch.arange(H) + 0.5, torch.arange(W) + 0.5, indexing="ij")
    grid = torch.stack([(x + motion[:, 0]) / W * 2 - 1, (y + motion[:, 1]) / H * 2 - 1], dim=-1)
    expected = F.grid_sample(image, grid, mode="bilinear", padding_mode="border", align_corners=False)
    torch.testing.assert_close(warp(image, motion), expected, atol=1e-4, rtol=1e-4)


def test_warp_by_whole_pixels_is_exact_and_bad_motion_is_none():
    image = torch.rand(1, 3, 6, 5)
    for cubic in (False, True):
        assert torch.equal(warp(image, torch.zeros(1, 2, 6, 5), cubic=cubic), image)
    bad = torch.full((1, 2, 6, 5), math.nan)
    bad[:, :, 3:] = math.inf
    assert torch.equal(warp(image, bad), image)
    far = torch.full((1, 2, 6, 5), 1e6)
    assert torch.equal(warp(image, far), image[:, :, -1:, -1:].expand_as(image))


def test_cubic_warp_is_exact_for_parabolas_and_overshoots_nowhere():
    y, x = torch.meshgrid(torch.arange(12.0), torch.arange(14.0), indexing="ij")
    motion = torch.tensor([0.3, -0.6]).reshape(1, 2, 1, 1).expand(1, 2, 12, 14)
    out = warp((x.square() + 5 * y)[None, None], motion, cubic=True)[0, 0]
    inner = slice(2, -3)  # whose 4×4 pixels are all on the screen
    torch.testing.assert_close(out[inner, inner], ((x + 0.3).square() + 5 * (y - 0.6))[inner, inner])
    step = (x > 6).float()[None, None]
    again = step
    for _ in range(8):
        again = warp(again, motion, cubic=True)
        assert again.min() >= 0 and again.max() <= 1
    blurred = step
    for _ in range(8):
        blurred = warp(blurred, motion)
    there = warp(step, 8 * motion)
    assert (again - there).abs().mean() < 0.6 * (blurred - there).abs().mean()


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.bfloat16])
@pytest.mark.parametrize("channels", [3, 12])
def test_warp_keeps_the_dtype_of_the_image(dtype, channels):
    image, motion = torch.rand(1, channels, 6, 5), torch.randn(1, 2, 6, 5)
    for cubic in (False, True):
        out = warp(image.to(dtype), motion, cubic=cubic)
        assert out.dtype == dtype
        torch.testing.assert_close(out.float(), warp(image, motion, cubic=cubic), atol=0.02, rtol=0)


@pytest.mark.parametrize("dtype", [torch.int64, torch.uint8, torch.bool])
def test_images_between_pixels_hold_floats(dtype):
    image = torch.ones(1, 3, 6, 5, dtype=dtype)
    for call in (
        lambda: warp(image, torch.zeros(1, 2, 6, 5)),
        lambda: warp(image, torch.zeros(1, 2, 6, 5), cubic=True),
        lambda: apply_kernel(image, torch.zeros(1, 9, 6, 5)),
    ):
        with pytest.raises(ValueError, match="expected an image of floats, got torch"):
            call()
    assert torch.equal(fetch(image, torch.zeros(1, 2, 6, 5)), image)


def test_kernels_over_arrays_are_refused():
    with pytest.raises(ValueError, match="expected tensors, got ndarray and Tensor"):
        apply_kernel(torch.ones(1, 3, 6, 5).numpy(), torch.zeros(1, 9, 6, 5))


def test_reproject_of_nothing_is_refused():
    surface = torch.ones(1, 1, 4, 4), torch.ones(1, 3, 4, 4)
    with pytest.raises(ValueError, match="got none"):
        reproject([], torch.zeros(1, 2, 4, 4), surface, surface)


def test_warp_gradients():
    image = torch.randn(1, 2, 4, 5, dtype=torch.float64, requires_grad=True)
    motion = (torch.randint(-3, 3, (1, 2, 4, 5)) + 0.1 + 0.8 * torch.rand(1, 2, 4, 5)).double().requires_grad_()
    for cubic in (False, True):
        assert torch.autograd.gradcheck(lambda i, m, cubic=cubic: warp(i, m, cubic=cubic), (image, motion))
    assert torch.autograd.gradcheck(lambda i: fetch(i, motion.detach()), (image,))


def test_downsample_of_one_lit_pixel():
    assert torch.equal(downsample(impulse(6, 6, 3, 4)), impulse(3, 3, 1, 2) / 4)
    assert torch.equal(downsample(impulse(6, 6, 3, 4), "max"), impulse(3, 3, 1, 2))
    assert torch.equal(downsample(impulse(5, 5, 4, 4)), impulse(3, 3, 2, 2))  # the corner cell holds one pixel


def test_upsample_of_one_lit_pixel():
    row = upsample(torch.tensor([0.0, 1.0, 0.0]).reshape(1, 1, 1, 3), (1, 5)).flatten().tolist()
    assert row == [0, 0.25, 0.75, 0.75, 0.25]


def test_nearest_takes_one_pixel_and_repeats_it():
    image = torch.arange(15.0).reshape(1, 1, 3, 5)
    coarse = downsample(image, "nearest")
    assert coarse.flatten().tolist() == [0, 2, 4, 10, 12, 14]
    assert upsample(coarse, (3, 5), "nearest")[0, 0, 1].tolist() == [0, 0, 2, 2, 4]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("pool", ["mean", "max", "nearest"])
def test_compose_is_equation_4(size, pool):
    H, W = size
    fine, coarse = torch.rand(1, 3, H, W), torch.rand(1, 3, -(-H // 2), -(-W // 2))
    alpha = torch.rand(1, 1, *coarse.shape[2:])
    mode = "nearest" if pool == "nearest" else "bilinear"
    expected = fine - upsample(alpha * downsample(fine, pool), size, mode) + upsample(alpha * coarse, size, mode)
    torch.testing.assert_close(compose(fine, coarse, alpha, pool), expected)
    assert torch.equal(compose(fine, coarse, torch.zeros_like(alpha), pool), fine)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kernel", [1, 3, 5])
def test_pick_is_its_equation(size, kernel):
    H, W = size
    h, w, r = (H + 1) // 2, (W + 1) // 2, kernel // 2
    fine, coarse, share = torch.rand(2, 3, H, W), torch.rand(2, 3, h, w), torch.rand(2, 1, H, W)
    logits = 3 * torch.randn(2, kernel**2, H, W)
    expected = torch.empty_like(fine)
    for y in range(H):
        for x in range(W):
            rows, columns = ([i for i in range(n // 2 - r, n // 2 + r + 1) if 0 <= i < m] for n, m in ((y, h), (x, w)))
            taps = [(i - y // 2 + r) * kernel + j - x // 2 + r for i in rows for j in columns]
            cells = torch.stack([coarse[:, :, i, j] for i in rows for j in columns], dim=2)
            picked = (cells * logits[:, taps, y, x].softmax(1)[:, None]).sum(2)
            expected[:, :, y, x] = torch.lerp(fine[:, :, y, x], picked, share[:, :, y, x])
    torch.testing.assert_close(pick(fine, coarse, logits, share), expected)
    by_cells = cells_of(logits)
    torch.testing.assert_close(pick(fine, coarse, by_cells, share), expected)
    assert torch.equal(whole(by_cells)[:, :, :H, :W], logits)


def test_pick_crosses_no_edge():
    """A step in the middle of a cell: each pixel takes the pure cell on its own side, not the mixed one."""
    fine = torch.tensor([0.0, 0, 0, 1, 1, 1]).reshape(1, 1, 1, 6)
    coarse = downsample(fine)  # 0, ½, 1
    logits = torch.zeros(1, 9, 1, 6)
    logits[:, 3, :, :3], logits[:, 5, :, 3:] = 1e3, 1e3  # the cell on the left, on the right
    logits[:, 4, :, [0, 1, 4, 5]] = 2e3  # but the outer pixels' own
    assert torch.equal(pick(torch.full_like(fine, 9.0), coarse, logits, torch.ones(1, 1, 1, 6)), fine)


def test_pick_refuses_shapes_that_do_not_fit():
    shapes = (3, 5, 4), (3, 3, 2), (9, 5, 4), (1, 5, 4)
    fine, coarse, logits, share = (torch.zeros(1, *shape) for shape in shapes)
    for bad in (
        (fine, coarse[:, :, :2], logits, share), (fine, coarse, logits[:, :8], share),
        (fine, coarse, logits[:, :4], share), (fine, coarse, logits[..., :3], share), (fine, coarse, logits, fine),
        (fine, coarse, logits[0], share),
    ):  # fmt: skip
        with pytest.raises(ValueError, match="expected coarse"):
            pick(*bad)


@pytest.mark.parametrize("size", SIZES)
def test_soften_takes_out_what_only_the_finer_image_has(size):
    fine, composed, share = torch.rand(1, 3, *size), torch.rand(1, 3, *size), torch.rand(1, 1, *size)
    detail = fine - upsample(downsample(fine), size)
    torch.testing.assert_close(soften(composed, fine, share), composed - (1 - share) * detail)
    torch.testing.assert_close(soften(composed, fine, torch.ones_like(share)), composed)
    torch.testing.assert_close(soften(fine, fine, torch.zeros_like(share)), upsample(downsample(fine), size))
    with pytest.raises(ValueError, match="expected composed"):
        soften(composed, fine, share[:, :, :0])


def test_noise_that_composition_leaves_is_softened():
    """White noise on a flat wall: eq. 4 with α = 1 leaves the detail of a 5×5 mean, `soften` takes it out."""
    noise = torch.randn(1, 1, 256, 256)
    fine = apply_kernel(noise, torch.zeros(1, 25, 256, 256))
    coarse = apply_kernel(downsample(fine), torch.zeros(1, 25, 128, 128))
    composed = compose(fine, coarse, torch.ones(1, 1, 128, 128))
    softened = soften(composed, fine, torch.zeros(1, 1, 256, 256))
    assert softened.var() < 0.6 * composed.var()


def test_pyramid_gradients():
    fine = torch.randn(1, 2, 5, 4, dtype=torch.float64, requires_grad=True)
    coarse = torch.randn(1, 2, 3, 2, dtype=torch.float64, requires_grad=True)
    alpha = torch.rand(1, 1, 3, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(compose, (fine, coarse, alpha))
    assert torch.autograd.gradcheck(downsample, (fine,))
    composed = torch.randn(1, 2, 5, 4, dtype=torch.float64, requires_grad=True)
    kept = torch.rand(1, 1, 5, 4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(soften, (composed, fine, kept))
    logits = torch.randn(1, 9, 5, 4, dtype=torch.float64, requires_grad=True)
    share = torch.rand(1, 1, 5, 4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(pick, (fine, coarse, logits, share))
    assert torch.autograd.gradcheck(lambda c: upsample(c, (5, 4)), (coarse,))


def test_blend_is_equation_1_and_has_gradients():
    spatial, temporal = torch.tensor([4.0]).reshape(1, 1, 1, 1), torch.tensor([8.0]).reshape(1, 1, 1, 1)
    assert blend(spatial, temporal, torch.full((1, 1, 1, 1), 0.25)).item() == 7
    inputs = [torch.rand(1, c, 3, 4, dtype=torch.float64, requires_grad=True) for c in (3, 3, 1)]
    assert torch.autograd.gradcheck(blend, inputs)


def chosen(seen, otherwise):
    return warp(torch.zeros(2, 3, 4, 4), torch.zeros(2, 2, 4, 4), seen, otherwise)


def reprojected(surface, before):
    return reproject(torch.zeros(1, 3, 4, 4), torch.zeros(1, 2, 4, 4), surface, before)


def test_half_precision_motion_reaches_all_columns():
    image = torch.randn(1, 1, 2, 3000)
    for op in (fetch, warp):
        assert torch.equal(op(image, torch.zeros(1, 2, 2, 3000).half()), image)
    onward = torch.ones(1, 2, 2, 3000)
    for dtype in (torch.float16, torch.bfloat16):
        assert torch.equal(on_screen(onward.to(dtype)), on_screen(onward))


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: apply_kernel(torch.zeros(1, 3, 4, 4), torch.zeros(1, 24, 4, 4)), "got \\(1, 24, 4, 4\\)"),
        (lambda: apply_kernel(torch.zeros(1, 3, 4, 4), torch.zeros(1, 16, 4, 4)), "K odd"),
        (lambda: apply_kernel(torch.zeros(3, 4, 4), torch.zeros(1, 25, 4, 4)), "\\[B, C, H, W\\]"),
        (lambda: warp(torch.zeros(1, 3, 4, 4), torch.zeros(1, 2, 4, 5)), "got \\(1, 2, 4, 5\\)"),
        (lambda: fetch(torch.zeros(1, 3, 4, 4), torch.zeros(2, 2, 4, 4)), "got \\(2, 2, 4, 4\\)"),
        (lambda: chosen(torch.zeros(2, 1, 4, 4).bool(), None), "both of seen and otherwise"),
        (lambda: chosen(torch.zeros(1, 1, 4, 4).bool(), torch.zeros(2, 3, 4, 4)), "seen \\(2, 1, 4, 4\\)"),
        (lambda: chosen(torch.zeros(2, 1, 4, 4).bool(), torch.zeros(1, 1, 1, 1)), "otherwise \\(2, 3, 4, 4\\)"),
        (lambda: chosen(torch.zeros(2, 1, 4, 4), torch.zeros(2, 3, 4, 4)), "seen of torch.bool, got torch.float32"),
        (lambda: reprojected(surfaces(4, 4), surfaces(4, 3)), "depth_previous \\(1, 1, 4, 4\\)"),
        (lambda: reprojected([x[:, :1] for x in surfaces(4, 4)], surfaces(4, 4)), "normal \\(1, 3, 4, 4\\)"),
        (lambda: downsample(torch.zeros(1, 3, 4, 4), "median"), "'median'"),
        (lambda: upsample(torch.zeros(1, 3, 4, 4), (5, 5)), "coarse image of 3×3"),
        (lambda: upsample(torch.zeros(1, 3, 4, 4), (8, 8), "bicubic"), "'bicubic'"),
    ],
)
def test_wrong_shapes_are_named(call, message):
    """Also because compiled code would read beyond them."""
    with pytest.raises(ValueError, match=message):
        call()


def surfaces(H, W, depth=3.0):
    return torch.full((1, 1, H, W), depth), torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1).expand(1, 3, H, W)


@pytest.mark.parametrize("size", SIZES)
def test_reproject_is_warp_where_everything_is_one_surface(size):
    H, W = size
    stored, motion = torch.randn(1, 4, H, W), torch.rand(1, 2, H, W) * 0.8 - 0.4
    found, valid = reproject(stored, motion, surfaces(H, W), surfaces(H, W))
    inner = (..., slice(1, max(H - 1, 1)), slice(1, max(W - 1, 1)))
    torch.testing.assert_close(found[inner], warp(stored, motion)[inner])
    assert valid.all()


def test_reproject_takes_no_tap_from_another_surface():
    """Half a pixel to the right of column 2 lies the edge to a deeper surface in column 3."""
    depth, normal = surfaces(4, 8)
    depth = torch.where(torch.arange(8).expand(1, 1, 4, 8) > 2, 9.0, depth)
    stored = torch.arange(8.0).expand(1, 1, 4, 8)
    motion = torch.zeros(1, 2, 4, 8)
    motion[:, 0] = 0.5
    found, valid = reproject(stored, motion, (depth, normal), (depth, normal))
    assert found[0, 0, 0].tolist() == [0.5, 1.5, 2.0, 3.5, 4.5, 5.5, 6.5, 7.0] and valid.all()
    turned = normal.flip(1)  # a surface that faces elsewhere is another one
    found, valid = reproject(stored, motion, (depth, normal), (depth, turned))
    assert not valid.any() and not found.any()


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_reproject_does_not_read_what_has_no_weight(value):
    """A depth of a miss may be infinite: it stays where it is, and out of the surface beside it."""
    depth, normal = surfaces(4, 8)
    depth = torch.where(torch.arange(8).expand(1, 1, 4, 8) > 2, 9.0, depth)
    stored = torch.where(depth > 3, value, 1.0)
    motion = torch.zeros(1, 2, 4, 8)
    still, _ = reproject(stored, motion, (depth, normal), (depth, normal))
    motion[:, 0] = 0.5
    moved, valid = reproject(stored, motion, (depth, normal), (depth, normal))
    motion[:, 0] = 1e4
    away, found = reproject(stored, motion, (depth, normal), (depth, normal))
    for image in (still, moved):
        assert torch.equal(image[..., :3], torch.ones(1, 1, 4, 3)) and not image[..., 3:].isfinite().any()
    assert valid.all() and not found.any() and not away.any()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e30, 9.0, -9.0])
def test_reproject_finds_nothing_off_the_screen(bad):
    found, valid = reproject(torch.ones(1, 2, 4, 8), torch.full((1, 2, 4, 8), bad), surfaces(4, 8), surfaces(4, 8))
    assert not valid.any() and not found.any()


def test_compose_refuses_another_pool():
    with pytest.raises(ValueError, match="expected pool 'mean', 'max' or 'nearest', got 'sum'"):
        compose(torch.rand(1, 3, 4, 4), torch.rand(1, 3, 2, 2), torch.rand(1, 1, 2, 2), "sum")


def test_reproject_knows_misses():
    depth, normal = surfaces(4, 8, depth=0.0)
    still = torch.zeros(1, 2, 4, 8)
    assert reproject(torch.ones(1, 1, 4, 8), still, (depth, normal), (depth, normal))[1].all()
    assert not reproject(torch.ones(1, 1, 4, 8), still, surfaces(4, 8), (depth, normal))[1].any()


def test_reproject_gradients():
    H, W = 5, 6
    stored = torch.randn(1, 2, H, W, dtype=torch.float64, requires_grad=True)
    motion = torch.rand(1, 2, H, W, dtype=torch.float64) * 3 - 1.5
    surface = tuple(t.double() for t in surfaces(H, W))
    assert torch.autograd.gradcheck(lambda x: reproject(x, motion, surface, surface)[0], stored)
