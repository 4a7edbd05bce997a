"""Attention between channels: its equation, and the promises that strips and permutations rest on."""

import pytest
import torch
from tolerances import TOLERANCES

from rtdenoise.ops import attend_channels, use
from rtdenoise.ops.attend_channels import mix, sums


@pytest.fixture(autouse=True, params=["plain", "auto"])
def choice(request):
    with use(request.param):
        yield


def inputs(H=7, W=5, C=6, heads=2, B=2, dtype=torch.float32):
    g = torch.Generator().manual_seed(H * W)
    return *(torch.randn(B, C, H, W, generator=g, dtype=dtype) for _ in range(3)), torch.rand(heads, dtype=dtype) + 0.5


def close(found, expected, kind="float32"):
    relative, absolute = TOLERANCES[kind]
    torch.testing.assert_close(found, expected, rtol=relative, atol=absolute)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 5)])
@pytest.mark.parametrize("heads", [1, 2, 6])
def test_it_is_its_equation(size, heads):
    q, k, v, temperature = inputs(*size, heads=heads)
    d, out = 6 // heads, torch.zeros_like(v)
    for b in range(2):
        for h in range(heads):
            for i in range(d):
                row = torch.stack([
                    temperature[h] * (q[b, h * d + i] * k[b, h * d + j]).sum()
                    / (q[b, h * d + i].norm() * k[b, h * d + j].norm())
                    for j in range(d)
                ]).softmax(0)  # fmt: skip
                out[b, h * d + i] = sum(row[j] * v[b, h * d + j] for j in range(d))
    close(attend_channels(q, k, v, temperature, heads=heads), out)


def test_one_query_finds_the_channel_that_is_like_it():
    """The first output channel is the value of the key that points as the query does, where it is nothing else's."""
    _, k, v, _ = inputs(C=3, heads=1)
    k = torch.linalg.qr(k.flatten(2).mT)[0].mT.reshape(k.shape)  # channels at right angles over pixels
    out = attend_channels(100 * k.roll(1, 1), k, v, torch.tensor([1e3]), heads=1)
    close(out, v.roll(1, 1))


def test_permuting_pixels_permutes_the_result():
    q, k, v, temperature = inputs()
    order = torch.randperm(35, generator=torch.Generator().manual_seed(1))
    moved = [x.flatten(2)[:, :, order].reshape(x.shape) for x in (q, k, v)]
    expected = attend_channels(q, k, v, temperature, heads=2).flatten(2)[:, :, order].reshape(v.shape)
    close(attend_channels(*moved, temperature, heads=2), expected)


@pytest.mark.parametrize("rows", [1, 2, 3, 100])
def test_strips_are_the_whole(rows):
    q, k, v, temperature = inputs(H=64, W=48, C=8)
    close(attend_channels(q, k, v, temperature, heads=2, rows=rows), attend_channels(q, k, v, temperature, heads=2))


def test_scaling_queries_or_keys_changes_nothing():
    q, k, v, temperature = inputs()
    close(attend_channels(1e4 * q, 1e-4 * k, v, temperature, heads=2), attend_channels(q, k, v, temperature, heads=2))


@pytest.mark.parametrize("zeros", ["q", "k", "both"])
def test_zeros_are_alike_to_everything(zeros):
    q, k, v, temperature = inputs()
    q, k = (q * (zeros == "k")).requires_grad_(), (k * (zeros == "q")).requires_grad_()
    out = attend_channels(q, k, v, temperature, heads=2)
    close(out, v.unflatten(1, (2, 3)).mean(2, keepdim=True).expand(-1, -1, 3, -1, -1).reshape(v.shape))
    out.sum().backward()
    assert q.grad.isfinite().all() and k.grad.isfinite().all()


@pytest.mark.parametrize("rows", [None, 1])
def test_gradients(rows):
    tensors = [x.requires_grad_() for x in inputs(H=2, W=3, C=4, B=1, dtype=torch.float64)]
    assert torch.autograd.gradcheck(lambda *x: attend_channels(*x, heads=2, rows=rows), tensors)


def test_half_precision_sums_in_float32():
    """A million pixels: a sum in bfloat16 would stop growing at 256."""
    ones = torch.ones(1, 2, 1000, 1000, dtype=torch.bfloat16)
    found = sums(ones, ones, 1)
    assert found.products.dtype in (torch.float32, torch.float64) and (found.products == 1e6).all()
    with torch.autocast("cpu", torch.bfloat16):
        assert (sums(ones.float(), ones.float(), 1).products == 1e6).all()
    assert mix(found.weights(torch.ones(1)), ones).dtype == torch.bfloat16


def test_what_does_not_fit_is_said():
    q, k, v, temperature = inputs()
    with pytest.raises(ValueError, match=r"expected q, k, v \[B, C, H, W\], got \(2, 6, 7, 5\), \(2, 6, 7, 4\)"):
        attend_channels(q, k[..., :4], v, temperature, heads=2)
    with pytest.raises(ValueError, match="expected 6 channels in equal heads and a temperature for each, got 4 heads"):
        attend_channels(q, k, v, temperature, heads=4)
    for rows in (0, -1):
        with pytest.raises(ValueError, match=f"expected strips of 1 row or more, got {rows}"):
            attend_channels(q, k, v, temperature, heads=2, rows=rows)
