"""Programs that set torch's default dtype get the same pictures and gradients."""

import pytest
import torch
from synthetic import make_frames

from rtdenoise import Denoiser
from rtdenoise.models import create, read
from rtdenoise.ops import apply_kernel

FEATURES = "albedo", "normal", "depth", "motion", "motion_next"
FRAMES = [frame.map(torch.Tensor.float) for frame in make_frames(3, H=40, W=48)]


@pytest.fixture(params=[torch.float64, torch.bfloat16], ids=str)
def dtype(request):
    yield request.param
    torch.set_default_dtype(torch.float32)


def pictures(model, **options):
    denoiser = Denoiser(model, **options)
    return [denoiser(frame.radiance, **{name: getattr(frame, name) for name in FEATURES}) for frame in FRAMES]


@pytest.mark.parametrize(
    "model, precision", [("default", "fp32"), ("hybrid-fast", "fp32"), ("paper", "fp32"), ("hybrid-fast", "int8")]
)
def test_pictures(model, precision, dtype):
    expected = pictures(model, precision=precision)
    torch.set_default_dtype(dtype)
    for image, other in zip(pictures(model, precision=precision), expected, strict=True):
        assert image.dtype == torch.float32 and torch.equal(image, other)


def test_random_weights(dtype):
    config = read("fast").config
    torch.set_default_dtype(dtype)
    assert {p.dtype for p in create(config).parameters()} == {torch.float32}


def test_gradients(dtype):
    def gradients():
        torch.manual_seed(0)
        inputs = [torch.rand(1, c, 20, 24, dtype=torch.float32).requires_grad_() for c in (3, 9)]
        apply_kernel(*inputs).square().sum().backward()
        return [tensor.grad for tensor in inputs]

    expected = gradients()
    torch.set_default_dtype(dtype)
    for gradient, other in zip(gradients(), expected, strict=True):
        assert gradient.dtype == torch.float32 and torch.equal(gradient, other)
