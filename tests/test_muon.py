"""The optimiser of the shipped weights: its steps are orthogonal, of the promised length, and resumable."""

import pytest
import torch

from rtdenoise.training.muon import Muon, orthogonal


@pytest.mark.parametrize("shape", [(3, 3), (8, 50), (50, 8), (1, 9), (32, 288)])
def test_the_nearest_orthogonal_matrix(shape):
    """Of the same singular vectors, with singular values about 1, whatever the matrix's scale."""
    matrix = torch.randn(shape, generator=torch.Generator().manual_seed(1))
    left, _, right = torch.linalg.svd(matrix, full_matrices=False)
    for scale in (1e-4, 1.0, 1e12):
        found = left.T @ orthogonal(scale * matrix) @ right.T
        values = found.diagonal()
        assert values.min() > 0.4 and values.max() < 1.3, (shape, scale)
        assert (found - values.diag()).abs().max() < 1e-3


def test_no_gradient_no_step():
    assert torch.equal(orthogonal(torch.zeros(4, 6)), torch.zeros(4, 6))
    still = torch.nn.Parameter(torch.ones(4, 6))
    Muon([still], lr=1.0).step()
    assert torch.equal(still.detach(), torch.ones(4, 6))


def test_the_remains_of_a_momentum_come_to_nothing():
    matrix = torch.randn(32, 288, generator=torch.Generator().manual_seed(5))
    length = orthogonal(matrix).norm()
    for norm, share in ((1e-4, 1.0), (1e-7, 0.5), (1e-9, 0.01)):
        assert orthogonal(norm * matrix / matrix.norm()).norm() / length == pytest.approx(share, abs=0.01)


def test_a_layer_that_nothing_comes_through_comes_to_rest():
    """Its momentum dies away; steps of full length along its remains would lead anywhere, and in the end to
    NaN."""
    weight = torch.nn.Parameter(torch.zeros(8, 8))
    optimiser = Muon([weight], lr=0.01)
    weight.grad = torch.randn(8, 8, generator=torch.Generator().manual_seed(4))
    for step in range(3000):
        optimiser.step()
        weight.grad = torch.zeros(8, 8)
        if step == 1000:
            before = weight.detach().clone()
    torch.testing.assert_close(weight.detach(), before, rtol=0, atol=1e-4)


@pytest.mark.parametrize("shape", [(16, 8, 3, 3), (8, 16, 2, 2), (5, 4)])
def test_a_step_is_as_long_as_adams(shape):
    """lr in the quadratic mean over the entries, whatever the gradient's size; in any memory format."""
    weight = torch.nn.Parameter(torch.zeros(shape))
    if len(shape) == 4:
        weight.data = weight.data.to(memory_format=torch.channels_last)
    weight.grad = 1e-6 * torch.randn(shape, generator=torch.Generator().manual_seed(2))
    Muon([weight], lr=0.01).step()
    assert weight.detach().square().mean().sqrt() == pytest.approx(0.01, rel=0.25)


def test_it_learns_weak_directions_as_fast_as_strong_ones():
    """Where one input is ten times fainter than the other, its gradient is a hundred times fainter."""
    x = torch.randn(256, 2, generator=torch.Generator().manual_seed(3)) * torch.tensor([1.0, 0.1])
    wanted = torch.tensor([[1.0, -2.0], [0.5, 3.0], [-1.0, 1.0]])
    weight = torch.nn.Parameter(torch.zeros(3, 2))
    optimiser = Muon([weight], lr=0.05)
    for step in range(200):
        optimiser.param_groups[0]["lr"] = 0.05 * (1 - step / 200)
        optimiser.zero_grad()
        (x @ (weight - wanted).T).square().mean().backward()
        optimiser.step()
    assert (weight.detach() - wanted).abs().max() < 0.2
