"""Attention in blocks against its equation: one lit pixel, a loop, borders, any size, gradients."""

import itertools
import sys

import numpy as np
import pytest
import torch

from rtdenoise import glsl
from rtdenoise.glsl import GpuArray
from rtdenoise.ops import attend_blocks, use

SIZES = [(1, 1), (1, 9), (5, 17), (16, 24), (29, 35)]  # (H, W): sizes below a block, with cut-off blocks, in blocks


@pytest.fixture(autouse=True, params=["plain", "auto"])
def choice(request):
    """Every test runs with the specification and with the version in strips."""
    with use(request.param):
        yield


def arguments(H, W, block=8, halo=3, heads=2, channels=8, dtype=torch.float32):
    window = block + 2 * halo
    pictures = [torch.randn(2, channels, H, W, dtype=dtype) for _ in range(3)]
    return *pictures, *(torch.randn(channels // heads // 2, window, dtype=dtype) for _ in range(2))


def by_loop(q, k, v, rows, columns, block, halo, heads):
    """The equation of the docstring, pixel by pixel."""
    B, C, H, W = q.shape
    d, out = C // heads, torch.empty_like(v)
    for y, x, b, h in itertools.product(range(H), range(W), range(B), range(heads)):
        top, left = y // block * block - halo, x // block * block - halo
        window = [
            (i, j) for i, j in itertools.product(range(block + 2 * halo), repeat=2)
            if 0 <= top + i < H and 0 <= left + j < W
        ]  # fmt: skip
        part = slice(h * d, (h + 1) * d)
        keys = [k[b, part, top + i, left + j] + torch.cat([rows[:, i], columns[:, j]]) for i, j in window]
        weights = (torch.stack(keys) @ q[b, part, y, x] / d**0.5).softmax(0)
        out[b, part, y, x] = weights @ torch.stack([v[b, part, top + i, left + j] for i, j in window])
    return out


@pytest.mark.parametrize(("block", "halo", "heads"), [(8, 3, 2), (4, 0, 1), (3, 5, 4), (1, 1, 2)])
def test_it_is_its_equation(block, halo, heads):
    given = arguments(7, 10, block, halo, heads)
    torch.testing.assert_close(
        attend_blocks(*given, block=block, halo=halo, heads=heads), by_loop(*given, block, halo, heads)
    )


@pytest.mark.parametrize("size", SIZES)
def test_any_size_and_layout(size):
    q, k, v, rows, columns = arguments(*size)
    with use("plain"):
        expected = attend_blocks(q, k, v, rows, columns, heads=2)
    last = [x.to(memory_format=torch.channels_last) for x in (q, k, v)]
    for pictures in ((q, k, v), last):
        torch.testing.assert_close(attend_blocks(*pictures, rows, columns, heads=2), expected)


def test_pictures_of_bfloat16_beside_offsets_of_float32():
    q, k, v, rows, columns = arguments(9, 17)
    found = attend_blocks(q.bfloat16(), k.bfloat16(), v.bfloat16(), rows, columns, heads=2)
    assert found.dtype == torch.bfloat16
    torch.testing.assert_close(found.float(), attend_blocks(q, k, v, rows, columns, heads=2), rtol=0.05, atol=0.1)


@pytest.mark.parametrize("halo", [0, 3])
def test_a_lit_pixel_reaches_the_blocks_whose_windows_hold_it(halo):
    zero, lit = torch.zeros(1, 2, 32, 40), torch.zeros(1, 2, 32, 40)
    lit[..., 17, 22] = 1
    out = attend_blocks(zero, zero, lit, *torch.zeros(2, 1, 8 + 2 * halo), halo=halo, heads=1)
    expected = torch.zeros(32, 40, dtype=torch.bool)
    expected[16 - 8 * (halo > 1) : 24, 16 : 24 + 8 * (halo > 1)] = True  # 17 lies 2 rows, 22 2 columns from a border
    assert torch.equal(out[0, 0] > 0, expected)
    torch.testing.assert_close(out[0, 0, 18, 18], torch.tensor(1 / (8 + 2 * halo) ** 2))


def test_the_offset_of_a_key_is_that_of_its_place_in_the_window():
    """Queries that look for one row and one column of the window find the value there."""
    zero, place = torch.zeros(1, 2, 24, 24), torch.arange(24.0 * 24).reshape(1, 1, 24, 24).expand(1, 2, 24, 24)
    rows, columns = torch.zeros(1, 14), torch.zeros(1, 14)
    rows[:, 2], columns[:, 9] = 1000, 1000
    out = attend_blocks(zero + 1, zero, place.contiguous(), rows, columns, heads=1)
    assert (out[0, 0, 8:16, 8:16] == (8 - 3 + 2) * 24 + 8 - 3 + 9).all()


def test_a_constant_stays_constant_at_borders():
    q, k, v, rows, columns = arguments(13, 22)
    out = attend_blocks(q, k, torch.full_like(v, 0.7), rows, columns, heads=2)
    torch.testing.assert_close(out, torch.full_like(v, 0.7))


def test_a_window_wider_than_the_picture_attends_to_all_of_it():
    q, k, v, _, _ = arguments(5, 6, channels=4)
    none = torch.zeros(1, 8 + 2 * 9)
    out = attend_blocks(q, k, v, none, none, halo=9, heads=2)
    scores = torch.einsum("bhdp,bhdn->bhpn", *(x.flatten(2).unflatten(1, (2, 2)) for x in (q, k))) / 2**0.5
    expected = torch.einsum("bhpn,bhdn->bhdp", scores.softmax(-1), v.flatten(2).unflatten(1, (2, 2)))
    torch.testing.assert_close(out, expected.flatten(1, 2).unflatten(2, (5, 6)))


def test_swapped_pixels_of_a_window_change_nothing_but_their_own_queries():
    """Without offsets attention knows no order: keys and values of two pixels that the same windows hold may swap."""
    q, k, v, _, _ = arguments(24, 24)
    none = torch.zeros(2, 14)
    swapped = [x.clone() for x in (k, v)]
    for x, was in zip(swapped, (k, v), strict=True):
        x[..., 11, 12], x[..., 12, 11] = was[..., 12, 11], was[..., 11, 12]  # in the middle of a block: only its own
    out = attend_blocks(q, *swapped, none, none, heads=2)
    torch.testing.assert_close(out, attend_blocks(q, k, v, none, none, heads=2))


def test_strips_are_the_whole(monkeypatch):
    given = arguments(41, 37)
    expected = attend_blocks(*given, heads=2)
    for most in (1, 2 * 8 * 14**2 * 3, 2 * 8 * 14**2 * 11):  # a block, 3 and 11 at a time
        monkeypatch.setattr(sys.modules["rtdenoise.ops.attend_blocks"], "MAX_UNFOLDED", most)
        torch.testing.assert_close(attend_blocks(*given, heads=2), expected)


def test_gradients():
    given = arguments(5, 6, block=3, halo=1, heads=1, channels=2, dtype=torch.float64)
    given = [x[:1].requires_grad_() if x.ndim == 4 else x.requires_grad_() for x in given]
    assert torch.autograd.gradcheck(lambda *x: attend_blocks(*x, block=3, halo=1, heads=1), given)


def test_gradients_of_both_versions_are_the_same():
    given = [x.requires_grad_() for x in arguments(19, 26)]
    weights = torch.randn_like(given[0])
    with use("plain"):
        expected = torch.autograd.grad((attend_blocks(*given, heads=2) * weights).sum(), given)
    found = torch.autograd.grad((attend_blocks(*given, heads=2) * weights).sum(), given)
    for name, a, b in zip(["q", "k", "v", "rows", "columns"], found, expected, strict=True):
        torch.testing.assert_close(a, b, atol=1e-4, rtol=1e-4, msg=name)


def test_an_empty_batch_is_empty():
    q, k, v, rows, columns = arguments(8, 8)
    assert attend_blocks(q[:0], k[:0], v[:0], rows, columns, heads=2).shape == (0, 8, 8, 8)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"heads": 3}, "channels in 3 heads of an even number each, got block 8, halo 3 and 8 channels"),
        ({"halo": -1}, "a halo of 0 or more"),
        ({"halo": 2}, r"expected rows and columns \(2, 12\), got \(2, 14\) and \(2, 14\)"),
        ({"block": 0}, "expected a block of 1 or more"),
    ],
)
def test_wrong_shapes_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        attend_blocks(*arguments(8, 8), **{"heads": 2} | change)
    q, k, v, rows, columns = arguments(8, 8)
    with pytest.raises(ValueError, match="of one shape, got"):
        attend_blocks(q, k, v[:, :4], rows, columns, heads=2)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("block", "halo", "heads"), [(8, 3, 2), (8, 0, 1), (5, 6, 4)])
def test_the_shader_is_its_twin(gl, assert_images_close, size, block, halo, heads):
    options = {"block": block, "halo": halo, "heads": heads}
    given = [x.numpy() for x in arguments(*size, **options)]
    expected = attend_blocks(*(torch.from_numpy(x) for x in given), **options).numpy()
    resident = [GpuArray.upload(gl, x) for x in given]
    out = GpuArray.upload(gl, np.full(expected.shape, np.nan))
    assert glsl.attend_blocks(*resident, out, **options) is out
    assert_images_close(out.read(), expected, "float32 attention")
    assert np.array_equal(glsl.attend_blocks(*given, **options), out.read())


def test_the_shader_keeps_constants_and_survives_extreme_scores(gl, assert_images_close):
    q, k, v, rows, columns = (x.numpy() for x in arguments(13, 9))
    even = np.full_like(v, 0.7)
    for size in (0.0, 1e4):
        out = glsl.attend_blocks(size * q, size * k, even, rows, columns, heads=2)
        assert_images_close(out, even, "float32 attention")


def test_the_shader_names_what_does_not_fit():
    q, k, v, rows, columns = (x.numpy() for x in arguments(8, 8))
    with pytest.raises(ValueError, match=r"expected v \(2, 8, 8, 8\), got \(2, 4, 8, 8\)"):
        glsl.attend_blocks(q, k, v[:, :4], rows, columns, heads=2)
    with pytest.raises(ValueError, match=r"expected columns \(2, 12\), got \(2, 14\)"):
        glsl.attend_blocks(q, k, v, rows[:, 1:-1], columns, halo=2, heads=2)
    with pytest.raises(ValueError, match="channels in 3 heads of an even number each"):
        glsl.attend_blocks(q, k, v, rows, columns, heads=3)
