"""The curve on which networks that write pixels see light."""

import math

import pytest
import torch

from rtdenoise.ops.dispatch import use
from rtdenoise.ops.lift import lift, lower

CHOICES = "plain", "fused"


def oidns(y):
    """OIDN's curve in units of its logarithm (`PUTransferFunction` of Open Image Denoise), in double precision."""
    if y <= 1.57945760e-06:
        value = 1.41283765e03 * y
    elif y <= 3.22087631e-02:
        value = 1.64593172 * y**4.31384981e-01 - 2.94139609e-03
    else:
        value = 1.92653254e-01 * math.log(y + 6.26026094e-03) + 9.98620152e-01
    return value / 1.92653254e-01


@pytest.mark.parametrize("choice", CHOICES)
def test_its_logarithm_is_oidns_curve(choice):
    light = [0.0, 1e-9, 1.5e-6, 1.6e-6, 1e-4, 0.03, 0.0322, 0.0323, 0.5, 7.0, 1e6]
    with use(choice):
        found = lift(torch.tensor(light).expand(1, 3, 1, -1)).double().log1p()
    expected = torch.tensor([oidns(y) for y in light]).double().expand(1, 3, 1, -1)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("choice", CHOICES)
def test_it_rises_and_comes_back(choice):
    light = torch.cat([torch.zeros(1), torch.logspace(-12, 30, 5000)]).expand(1, 3, 1, -1)
    with use(choice):
        lifted = lift(light)
        back = lower(lifted)
    assert (lifted[..., 1:] > lifted[..., :-1]).all() and not lifted[..., 0].any() and not back[..., 0].any()
    torch.testing.assert_close(back, light, rtol=5e-6, atol=0)


@pytest.mark.parametrize("choice", CHOICES)
def test_a_pure_colour_comes_back_and_is_never_pure_to_the_network(choice):
    light = torch.eye(3).reshape(3, 3, 1, 1) * torch.logspace(-6, 8, 300)
    with use(choice):
        lifted = lift(light)
        back = lower(lifted)
    assert (lifted > 0).all() and (lifted.amin(1) < lifted.amax(1)).all()
    brightest = light.amax(1, keepdim=True)
    torch.testing.assert_close(back / brightest, light / brightest, rtol=1e-5, atol=1e-6)
    assert (back >= 0).all()


def test_gradients_go_through():
    light = torch.logspace(-7, 2, 10).double().reshape(1, 1, 1, -1).requires_grad_()
    for op in (lift, lower):
        assert torch.autograd.gradcheck(op, light, eps=1e-9, rtol=1e-3)
