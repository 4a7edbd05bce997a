"""How the pictures of a kernel network and of one that writes pixels become one (`ops.mix`)."""

import torch

from rtdenoise import ops
from rtdenoise.color import compress, expand
from rtdenoise.constants import MIX_SHARES, MIX_UNCOVERED, MIX_WORD_FROM, MIX_WORD_WHOLE
from rtdenoise.models.hybrid import heard
from rtdenoise.ops.evened import held_and_tells
from rtdenoise.ops.mix import mix as mixture
from rtdenoise.ops.mix import share_told


def mix(image, picture, scale, trust=1.0, before=None, held=1.0, shares=MIX_SHARES, noisy=None, depth=None, word=None):
    """`ops.mix` with one number, or a picture of them, for trust and held."""
    trust, held = (torch.as_tensor(x).expand_as(image[:, :1]) for x in (trust, held))
    held, tells = held_and_tells(held, image.dtype)
    tells = None if noisy is None else tells
    return mixture(image, picture, scale, trust, shares, before, held, noisy, tells, depth, word)


def test_it_is_between_all_pictures():
    """Of light that is constant all know it."""
    one = torch.ones(1, 1, 1, 1)
    image, picture, before = (torch.full((1, 3, 8, 8), x) for x in (2.0, 8.0, 4.0))
    found = mix(image, picture, one)
    assert ((found > 2) & (found < 8)).all()
    nearer = mix(image, picture, one, before=before)
    assert ((nearer > 4) & (nearer < found)).all()
    assert torch.allclose(mix(image, image, one, 0.3, image), image, rtol=1e-5)
    assert torch.allclose(mix(8 * image, 8 * picture, one / 8, 1.0, 8 * before), 8 * nearer, rtol=1e-5)
    assert torch.allclose(mix(image, picture, one, 0.0, before), picture, rtol=1e-5)
    assert torch.allclose(mix(image, picture, one, 1.0, before, held=0.0), found, rtol=1e-5)


def test_a_previous_picture_far_from_the_mixture_counts_as_a_nearer_one():
    """What an edge has left in it makes no outline."""
    one = torch.ones(1, 1, 1, 1)
    image, near, far, beyond = (torch.full((1, 3, 8, 8), x) for x in (1.0, 1.2, 4.0, 400.0))
    found = [mix(image, image, one, before=before) for before in (near, far, beyond, 1e-3 * near)]
    assert (image < found[0]).all() and (found[0] < found[1]).all() and torch.equal(found[1], found[2])
    torch.testing.assert_close(found[1].log1p() - image.log1p(), image.log1p() - found[3].log1p(), rtol=1e-3, atol=1e-6)


def told(noisy, first, other, usual=0.4):
    return share_told(noisy, first, other, torch.ones(1, 1, 1, 1), usual)


def test_the_frame_tells_which_picture_is_nearer():
    """Between what is usual and least squares: all the way where there is no noise, not at all where all is noise."""
    torch.manual_seed(0)
    truth, smooth = 0.1 + torch.rand(1, 3, 48, 48), torch.full((1, 3, 48, 48), 0.6)
    assert told(truth, truth, smooth).min() > 0.75 and told(truth, smooth, truth).max() < 0.2
    sparse = 64 * truth * (torch.rand(1, 1, 48, 48) < 1 / 64)  # one sample in 64 finds the light
    assert (told(sparse, truth, smooth) - 0.4).abs().max() < 0.1
    assert torch.allclose(told(truth, truth, truth), torch.tensor(0.4))
    some = truth + 0.3 * torch.randn_like(truth)
    assert 0.4 < told(some, truth, smooth).mean() < told(truth, truth, smooth).mean()


def test_what_the_frame_tells_depends_on_no_unit_and_is_finite():
    torch.manual_seed(0)
    noisy, first, other = (torch.rand(1, 3, 20, 31) for _ in range(3))
    found = told(noisy, first, other)
    scaled = share_told(1e4 * noisy, 1e4 * first, 1e4 * other, torch.full((1, 1, 1, 1), 1e-4), 0.4)
    assert found.shape == (1, 1, 20, 31) and torch.allclose(scaled, found, rtol=1e-3)
    noisy[..., 4, 5] = 1e38
    beside = told(noisy, first, other)
    assert beside.isfinite().all() and torch.equal(beside[..., 12:, 15:], found[..., 12:, 15:])
    for size in ((1, 1), (2, 5)):
        assert told(*torch.rand(3, 1, 3, *size)).shape == (1, 1, *size)
    assert told(*torch.zeros(3, 1, 3, 8, 8)).isfinite().all()


def test_the_mixture_goes_where_the_frame_leads():
    torch.manual_seed(0)
    truth, smooth, one = 0.1 + torch.rand(1, 3, 48, 48), torch.full((1, 3, 48, 48), 0.6), torch.ones(1, 1, 1, 1)
    error = [(mix(smooth, truth, one, noisy=noisy) - truth).square().mean() for noisy in (None, truth)]
    assert error[1] < 0.3 * error[0]
    assert torch.equal(mix(smooth, truth, one, 0.0, noisy=truth), mix(smooth, truth, one, 0.0))
    held = torch.ones(1, 1, 48, 48)
    held[..., :16, :16] = 0  # just uncovered, among pixels that tell of their own past: the first is near the other
    apart = (compress(smooth) - compress(truth)).clamp(-MIX_UNCOVERED, MIX_UNCOVERED)
    assert (apart.abs() == MIX_UNCOVERED).float().mean() > 0.2
    near = expand(compress(truth) + apart)
    plain, far = (mix(first, truth, one, before=smooth, held=held) for first in (near, smooth))
    led = mix(smooth, truth, one, before=smooth, held=held, noisy=truth)
    torch.testing.assert_close(led[..., :16, :16], plain[..., :16, :16], rtol=1e-5, atol=1e-6)
    assert (led != far)[..., 16:].float().mean() > 0.9
    few = mix(smooth, truth, one, before=smooth, held=held, shares=(0.4, 0.1, 0.1), noisy=truth)  # 0.1 at least
    less = mix(near, truth, one, before=smooth, held=held, shares=(0.1, 0.1, 0.1))
    torch.testing.assert_close(few[..., :16, :16], less[..., :16, :16])
    nowhere = mix(smooth, truth, one, before=smooth, held=0 * held, noisy=truth)  # none has a past: as a first frame
    assert torch.equal(nowhere, mix(smooth, truth, one, noisy=truth))


def test_the_word_of_few_samples_counts_as_far_as_there_is_noise():
    torch.manual_seed(0)
    truth, smooth, one = 0.1 + torch.rand(1, 3, 48, 48), torch.full((1, 3, 48, 48), 0.6), torch.ones(1, 1, 1, 1)
    plain, led = mix(smooth, truth, one), mix(smooth, truth, one, noisy=truth)
    assert torch.equal(mix(smooth, truth, one, noisy=truth, word=one), led)
    torch.testing.assert_close(mix(smooth, truth, one, noisy=truth, word=0 * one), plain, rtol=1e-5, atol=1e-6)
    half = mix(smooth, truth, one, noisy=truth, word=0.5 * one)
    between = (half - plain).abs() + (half - led).abs() - (led - plain).abs()
    assert between.max() < 1e-5 and (half - plain).abs().max() > 0.01
    noise = torch.tensor([0.0, MIX_WORD_FROM, 1e3, MIX_WORD_WHOLE]).view(4, 1, 1, 1)
    assert heard(noise).flatten().tolist() == [0, 0, 1, 1]


def test_before_the_sky_the_other_shows_alone():
    """Where neither a pixel nor one around it hit anything."""
    one, depth = torch.ones(1, 1, 1, 1), torch.zeros(1, 1, 8, 8)
    depth[..., 3, 3] = 5.0
    image, picture = (torch.full((1, 3, 8, 8), x) for x in (2.0, 8.0))
    mixed = mix(image, picture, one)
    around = torch.zeros(1, 1, 8, 8, dtype=torch.bool)
    around[..., 2:5, 2:5] = True
    for choice in ("plain", "fused"):
        with ops.use(choice):
            found = mix(image, picture, one, depth=depth)
            torch.testing.assert_close(found, torch.where(around, mixed, picture), rtol=1e-5, atol=0)
