"""Programs that set torch's default dtype, or its default device, get the same pictures and gradients."""

import numpy as np
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


def pictures(model, frames=FRAMES, **options):
    denoiser = Denoiser(model, **options)
    images = [denoiser(frame.radiance, **{name: getattr(frame, name) for name in FEATURES}) for frame in frames]
    return [image for image in (*images, *denoiser.flush()) if image is not None]


@pytest.mark.parametrize(
    "model, precision", [("default", "fp32"), ("hybrid-fast", "fp32"), ("paper", "fp32"), ("hybrid-fast", "int8")]
)
def test_pictures(model, precision, dtype):
    expected = pictures(model, precision=precision)
    torch.set_default_dtype(dtype)
    for image, other in zip(pictures(model, precision=precision), expected, strict=True):
        assert image.dtype == torch.float32 and torch.equal(image, other)


@pytest.mark.parametrize("options", [{"precision": "fp32"}, {"precision": "int8"}, {"lookahead": 3}], ids=str)
def test_pictures_of_another_default_device(options):
    arrays = [frame.map(torch.Tensor.numpy) for frame in FRAMES]
    expected = pictures("hybrid-fast", arrays, device="cpu", **options)
    torch.set_default_device("meta")  # holds no values: whatever lies there cannot be in a picture
    try:
        found = pictures("hybrid-fast", arrays, device="cpu", **options)
    finally:
        torch.set_default_device(None)
    assert all(np.array_equal(image, other) for image, other in zip(found, expected, strict=True))


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
