"""What defines each baseline."""

import pytest
import torch
from synthetic import make_frames

from rtdenoise.baselines import Accumulate, Oidn


def test_accumulation_is_the_running_mean_until_alpha():
    method, history = Accumulate(alpha=0.25), None
    frames = [frame.map(lambda t: t) for frame in make_frames(4)]
    wall = (slice(None), slice(None), slice(18, 24))  # where nothing moves
    for i, frame in enumerate(frames):
        image, history = method.step(frame, history)
        mean = torch.stack([f.radiance for f in frames[: i + 1]]).mean(0)
        torch.testing.assert_close(image[wall], mean[wall])
        assert history.length[0, 0, 20, 20] == i + 1
    image, _ = method.step(frames[0], history)
    expected = 0.25 * frames[0].radiance + 0.75 * history.radiance
    torch.testing.assert_close(image[wall], expected[wall])


def test_accumulation_starts_anew_off_the_screen():
    method = Accumulate()
    first, second = make_frames(2)
    _, history = method.step(first)
    away = second.motion + 1e4
    image, history = method.step(second.map(lambda t: away if t is second.motion else t), history)
    assert torch.equal(image, second.radiance) and history.length.max() == 1


@pytest.mark.parametrize("quality", ["high", "fast"])
def test_oidn_denoises_and_keeps_the_exposure(quality):
    frame = make_frames(1, H=64, W=96)[0]
    image, history = Oidn(quality).step(frame)
    assert history is None and image.shape == frame.radiance.shape
    before, after = ((x - frame.reference).square().mean() for x in (frame.radiance, image))
    assert after < 0.1 * before
    assert image.mean().item() == pytest.approx(frame.reference.mean().item(), rel=0.1)
