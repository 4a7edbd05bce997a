"""`models.settled`: a picture with that of the next frame in it, and what it leaves as it is."""

from dataclasses import replace
from itertools import pairwise

import pytest
import torch
from synthetic import make_frames

from rtdenoise import models, ops
from rtdenoise.constants import SETTLE_BROAD, SETTLE_BROAD_NEW, SETTLE_FAR
from rtdenoise.frame import Frame, History
from rtdenoise.models.settled import settled
from rtdenoise.ops.settle import settle
from rtdenoise.run.lookahead import Lookahead
from rtdenoise.run.torch_backend import TorchBackend
from rtdenoise.splat import completed_shot

SIZE = 48, 64


def left(image, noisy=None, trusted=1.0, **layers):
    """The history of a step on a wall that stands still."""
    one = torch.ones(1, 1, *SIZE)
    normal = torch.cat([0 * one, 0 * one, -one], dim=1)
    wall = {"motion_next": torch.zeros(1, 2, *SIZE), "depth": 4 * one, "normal": normal}
    return History(image, **(wall | layers), noisy=noisy, trusted=trusted * one)


def wall(seed=0):
    """Two pictures of even light with blotches of their own, and a frame of a sample a pixel."""
    torch.manual_seed(seed)
    coarse = 1 + 0.1 * torch.randn(2, 3, SIZE[0] // 8, SIZE[1] // 8)
    first, second = torch.nn.functional.interpolate(coarse, scale_factor=8, mode="bilinear").split(1)
    return first, second, torch.distributions.Exponential(1.0).sample((1, 3, *SIZE))


def error(image):
    return (image - 1).square().mean().item()


@pytest.mark.parametrize(("trusted", "share"), [(1.0, SETTLE_BROAD), (0.0, SETTLE_BROAD_NEW)])
def test_it_is_closer_to_the_truth(trusted, share):
    """Most where the first has no history."""
    first, second, noisy = wall()
    found = settled(left(first, noisy, trusted), left(second))
    assert error(found) / error(first) == pytest.approx((1 - share) ** 2 + share**2, abs=0.15)


def test_other_light_other_surfaces_and_the_border_stay():
    first, second, noisy = wall()
    here = left(first, noisy)
    out = torch.zeros(1, 2, *SIZE)
    out[:, 0] = SIZE[1]
    for after, following in (
        (here, left(second, trusted=0.0)),
        (here, left(second, depth=torch.full((1, 1, *SIZE), 9.0))),
        (replace(here, motion_next=out), left(second)),
    ):
        assert torch.equal(settled(after, following), first)


def test_what_is_as_it_was_rendered_stays():
    """As a sky without noise, which may move otherwise than its motion says."""
    first, second, noisy = wall()
    noisy[..., :20, :] = first[..., :20, :]
    found = settled(left(first, noisy), left(second))
    same = found == first
    assert same[..., :20, :].all() and not same[..., 20:, :].all()


def test_a_frame_without_noise_tells_that_light_has_moved():
    """As on water, whose light does not go with its surface, and where nothing else tells."""
    torch.manual_seed(0)
    first = 1 + torch.rand(1, 1, 1, SIZE[1]).expand(1, 3, *SIZE)
    following, noise = left(first.roll(3, dims=3)), wall()[2]
    noisy, clean = (
        (settled(left(first, first * (1 + amount * (noise - 1))), following) - first).abs().mean()
        for amount in (1.0, 0.01)
    )
    assert clean < 0.1 * noisy


def test_what_comes_before_a_surface_leaves_no_outline():
    """Its edge is read with what is behind it, and that is where it had not been."""
    first, _, noisy = wall()
    coming, motion = torch.zeros(1, 1, *SIZE, dtype=torch.bool), torch.zeros(1, 2, *SIZE)
    coming[..., 30:], motion[:, 0] = True, -3.3
    depth = torch.full((1, 1, *SIZE), 4.0)
    following = torch.where(coming, 3.0, torch.ones_like(first))
    found = settled(
        left(torch.ones_like(first), noisy, motion_next=motion), left(following, depth=depth.where(~coming, 2.0))
    )
    torch.testing.assert_close(found, torch.ones_like(first), atol=1e-3, rtol=0)


@pytest.mark.parametrize("speed", [0.0, 0.7])
def test_pictures_settle_at_edges_that_stay(speed):
    first, second, noisy = wall()
    motion, near = torch.zeros(1, 2, *SIZE), torch.full((1, 1, *SIZE), 4.0)
    motion[:, 0], near[..., 30:] = speed, 2.0
    found = settled(left(first, noisy, depth=near, motion_next=motion), left(second, depth=near))
    assert (found != first).all(1)[..., 2:-2, 2:-2].all()


def test_greater_differences_count_no_more():
    first = torch.ones(1, 3, *SIZE)
    same = torch.ones(1, 1, *SIZE)
    far = settle(first, 100 * first, 1e6 * first, same, same, torch.ones(1, 1, 1, 1))
    expected = (torch.log(2 * first) + SETTLE_BROAD * SETTLE_FAR).expm1()
    torch.testing.assert_close(far, expected)


@pytest.mark.parametrize("choice", ["plain", "fused"])
@pytest.mark.parametrize("brightness", [0.0, 1e-30, 1e-6, 65504.0, 1e30])
def test_it_stays_finite_and_between_both_pictures(choice, brightness):
    first, second, noisy = (brightness * image for image in wall())
    with ops.use(choice):
        found = settled(left(first, noisy), left(second))
    assert found.isfinite().all() and found.min() >= 0
    assert (found - first).abs().max() <= 1.01 * (second - first).abs().max()


def test_a_camera_that_goes_ahead_finds_its_surfaces():
    first, second, noisy = wall()
    near = left(second, depth=torch.full((1, 1, *SIZE), 3.0))
    assert torch.equal(settled(left(first, noisy), near), first)
    by = torch.ones(1, 1, 1, 1)
    assert torch.equal(settled(left(first, noisy), near, by), settled(left(first, noisy), left(second)))


@pytest.mark.parametrize("model", ["default", "hybrid"])
def test_steps_tell_how_far_they_trust_history(model):
    network, (first, second) = models.load(model, precision="fp32"), completed_shot(make_frames(2))
    with torch.inference_mode():
        assert network.step(first)[1].trusted is None  # others need not know
        network.keeps_trust = True
        _, after = network.step(first)
        assert not after.trusted.any()
        _, after = network.step(second, after)
    assert after.trusted.min() >= 0 and 0.5 < after.trusted.max() <= 1


def test_the_last_of_the_frames_ahead_settles():
    """Steps get one frame fewer; the last picture of a shot is that of its step."""
    shot, delay = make_frames(6), 3
    backend = TorchBackend("default", "cpu", "fp32", lookahead=delay)
    prepared = completed_shot([backend.prepare(frame) for frame in shot])
    history, steps = None, []
    for i, frame in enumerate(prepared):
        image, history = backend.denoise(frame, history, tuple(prepared[i + 1 : i + delay]))
        steps.append((frame, image, history))
    expected = [backend.settled(*a[::2], *b[::2]) for a, b in pairwise(steps)] + [steps[-1][1]]
    step, history, found = Lookahead(backend, delay).step, None, []
    for frame in [*map(backend.prepare, shot), *delay * [None]]:
        image, history = step(frame, history)
        found += [] if image is None else [image]
    assert len(found) == 6 and all(map(torch.equal, found, expected))
    assert not torch.equal(found[2], steps[2][1])


def test_a_backend_finds_how_far_the_camera_has_gone_ahead():
    backend, (first, second, noisy) = TorchBackend("default", "cpu", "fp32", lookahead=3), wall()
    before, after = left(first, noisy), left(second, noisy, depth=torch.full((1, 1, *SIZE), 3.5))
    frames = [
        Frame(noisy, noisy.clamp(max=1), its.normal, its.depth, before.motion_next, before.motion_next)
        for its in (before, after)
    ]
    found = settled(before, after, torch.full((1, 1, 1, 1), 0.5))
    assert torch.equal(settled(before, after), first) and not torch.equal(found, first)
    assert torch.equal(backend.settled(frames[0], before, frames[1], after), found)


def test_two_frames_ahead_are_both_for_the_step():
    assert not TorchBackend("default", "cpu", "fp32", lookahead=2).settles
    assert not TorchBackend("default", "cpu", "fp32", lookahead=4, correct=True).settles
