"""`denoise --oidn`: OIDN's picture of the averaged light, mixed into the network's."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import assert_goes_on, make_frames, write_sequence

from rtdenoise import Denoiser, models
from rtdenoise.baselines import Oidn
from rtdenoise.cli.main import main
from rtdenoise.constants import MIX_SHARES, MIX_SHARES_OF_MANY
from rtdenoise.errors import InputError
from rtdenoise.evaluate.registry import choose
from rtdenoise.exposure import exposure
from rtdenoise.models import AccumulatedKPNConfig, past
from rtdenoise.models.mixing import mix
from rtdenoise.ops import warp
from rtdenoise.ops.mix import share_told
from rtdenoise.ops.recall import reset_of
from rtdenoise.run import opinion
from rtdenoise.run.backends import TorchBackend
from rtdenoise.run.denoise import Options, denoise
from rtdenoise.sanitise import sanitise
from rtdenoise.splat import history_motion

SMALL = AccumulatedKPNConfig(widths=(8, 12, 4, 8, 4), edge_kernel=3)


@pytest.fixture
def weights(tmp_path):
    torch.manual_seed(0)
    models.save(models.create(SMALL), tmp_path / "w.safetensors")
    return str(tmp_path / "w.safetensors")


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
    held[..., :16, :16] = 0  # just uncovered, among pixels that tell of their own past
    plain, led = (mix(smooth, truth, one, before=smooth, held=held, noisy=noisy) for noisy in (None, truth))
    assert torch.equal(led[..., :16, :16], plain[..., :16, :16]) and (led != plain)[..., 16:].float().mean() > 0.9
    few = mix(smooth, truth, one, before=smooth, held=held, shares=(0.4, 0.1, 0.1), noisy=truth)  # 0.1 at least
    less = mix(smooth, truth, one, before=smooth, held=held, shares=(0.1, 0.1, 0.1))
    torch.testing.assert_close(few[..., :16, :16], less[..., :16, :16])
    nowhere = mix(smooth, truth, one, before=smooth, held=0 * held, noisy=truth)  # none has a past: as a first frame
    assert torch.equal(nowhere, mix(smooth, truth, one, noisy=truth))


def recorder(seen):
    """OIDN, which notes the frames that it gets."""

    class Recorder(Oidn):
        def step(self, frame, history=None):
            seen.append(frame)
            return super().step(frame, history)

    return Recorder


def kept_weights(tmp_path):
    """Weights of a network that keeps recent frames by itself."""
    torch.manual_seed(0)
    models.save(models.create(replace(SMALL, recent=opinion.RECENT)), tmp_path / "recent.safetensors")
    return str(tmp_path / "recent.safetensors")


@pytest.mark.parametrize("few", [False, True])
def test_oidn_gets_the_average_and_the_picture_is_history(weights, few, monkeypatch, tmp_path):
    seen = []
    monkeypatch.setattr(opinion, "Oidn", recorder(seen))
    weights = kept_weights(tmp_path) if few else weights
    network = TorchBackend(weights, "cpu", "fp32", footprint=True)
    asked, history = TorchBackend(weights, "cpu", "fp32", oidn=True), None
    for frame in make_frames(4):
        plain, after = network.step(network.prepare(frame), history)
        image, onward = asked.step(asked.prepare(frame), history)
        for name, tensor in after.layers().items():
            assert torch.equal(tensor, onward.layers()[name]) is (name != "radiance"), name
        assert torch.equal(onward.radiance, torch.from_numpy(image))

        plain, trust, before, held = torch.from_numpy(plain), 1.0, None, 1.0
        if history is not None:
            motion, on_screen, uncovered = history_motion(frame, history, "dual")
            held = on_screen & ~uncovered
            trust = 1 - held * reset_of(after.recent[0])
            assert (trust > 0).all() and (trust < 1).any()
            before = warp(history.radiance, motion, on_screen, plain, cubic=True) if few else None
        shares = MIX_SHARES if few else MIX_SHARES_OF_MANY
        picture = Oidn().step(seen[-1])[0]
        expected = mix(plain, picture, exposure(plain), trust, before, held, shares, sanitise(frame).radiance)
        assert np.allclose(image, expected.numpy(), rtol=1e-4, atol=1e-5)
        history = onward
    noise, averaged = (x - frame.reference for x in (frame.radiance, seen[-1].radiance))
    assert averaged.square().mean() < 0.6 * noise.square().mean()
    assert len(history.recent) == 4


def test_where_light_has_changed_the_picture_is_oidns(monkeypatch, tmp_path):
    """A network that gives its history up entirely has no say, and the previous picture none either."""
    picture = torch.full((1, 3, 24, 32), 0.25)
    monkeypatch.setattr(Oidn, "step", lambda self, frame, history=None: (picture, None))
    monkeypatch.setattr(opinion, "reset_of", lambda kept: torch.ones_like(kept[:, :1], dtype=torch.float32))
    asked = TorchBackend(kept_weights(tmp_path), "cpu", "fp32", oidn=True)
    first, second = make_frames(2, H=24, W=32)
    history = asked.step(asked.prepare(first), None)[1]
    image, _ = asked.step(asked.prepare(second), history)
    _, seen, uncovered = history_motion(second, history, "dual")
    held = (seen & ~uncovered).expand(1, 3, -1, -1).numpy()
    assert held.any() and np.allclose(image[held], 0.25, rtol=1e-5) and not np.allclose(image[~held], 0.25)


def test_light_that_one_frame_has_seen_is_evened_with_the_networks_image(monkeypatch, tmp_path):
    """Not in the first frame, where all of it is as noisy; in the second, the right half has come much nearer. In the
    third all has, and all of it is as noisy again."""
    seen = []
    monkeypatch.setattr(Oidn, "step", lambda self, frame, history=None: (seen.append(frame) or frame.radiance, None))
    weights = kept_weights(tmp_path)
    asked, network = TorchBackend(weights, "cpu", "fp32", oidn=True), TorchBackend(weights, "cpu", "fp32")
    first, second, third = make_frames(3, H=24, W=32)
    right = torch.arange(32) >= 16
    second = replace(second, depth=torch.where(right, second.depth / 9, second.depth))
    third = replace(third, depth=third.depth / 99)
    _, history = asked.step(asked.prepare(first), None)
    plain, _ = network.step(network.prepare(second), history)
    _, onward = asked.step(asked.prepare(second), history)
    _, last = asked.step(asked.prepare(third), onward)
    assert torch.equal(seen[0].radiance, first.radiance) and (last.footprint_count == 1).all()
    assert torch.equal(seen[2].radiance, past.seen(sanitise(third), onward, last)[:, :3])

    count, light = onward.footprint_count, past.seen(sanitise(second), history, onward)[:, :3]
    assert (count[..., 18:] == 1).all() and count[..., ~right].mean() > 1.2
    _, on_screen, uncovered = history_motion(second, history, "dual")
    trust = 1 - (on_screen & ~uncovered) * reset_of(onward.recent[0])
    share = 0.4 * trust * (2 - count).clamp(0, 1) * (count.max() - 1).clamp(0, 1)  # of the image
    assert torch.allclose(seen[1].radiance, light + share * (torch.from_numpy(plain) - light), rtol=1e-4, atol=1e-5)


def test_an_interrupted_run_goes_on_to_the_bit(weights, tmp_path):
    shot = write_sequence(tmp_path / "shot", make_frames(6))
    options = Options(model=weights, precision="fp32", float32=True, oidn=True)
    assert_goes_on(shot, tmp_path, options, 3)
    with pytest.raises(InputError, match="oidn"):
        denoise(str(shot), tmp_path / "parts", replace(options, oidn=False))


def test_from_python(weights):
    layers = {name: tensor[0].permute(1, 2, 0).numpy() for name, tensor in make_frames(1)[0].layers()}
    layers = {name: layers[name] for name in ("radiance", "albedo", "normal", "depth", "motion", "motion_next")}
    color = layers.pop("radiance")
    with_oidn, without = Denoiser(weights, oidn=True), Denoiser(weights)
    assert not np.allclose(with_oidn(color, **layers), without(color, **layers), rtol=1e-3)
    two = {name: np.stack([array, array]).transpose(0, 3, 1, 2) for name, array in layers.items()}
    with pytest.raises(InputError, match="one picture at a time"):
        Denoiser(weights, oidn=True)(np.stack([color, color]).transpose(0, 3, 1, 2), **two)
    with pytest.raises(InputError, match=r"^oidn: model 'paper' does not average light"):
        Denoiser("paper", oidn=True)
    with pytest.raises(InputError, match="goes without correct"):
        Denoiser(weights, oidn=True, correct=True)


def test_what_does_not_go_together_is_refused(weights, tmp_path, capsys, monkeypatch):
    shot = str(write_sequence(tmp_path / "shot", make_frames(1)))

    def refused(*options):
        with pytest.raises(SystemExit):
            main(["denoise", shot, "--out", str(tmp_path / "out"), "--oidn", *options])
        message = capsys.readouterr().err
        assert message.count("\n") == 1
        return message

    for option in ("--offline", "--correct", "--lights"):
        assert "--oidn: goes without --offline" in refused("--model", weights, option)
    assert "does not average light" in refused("--model", "paper")
    assert "runs in PyTorch alone" in refused("--model", weights, "--backend", "glsl")
    monkeypatch.setattr(opinion, "installed", lambda: False)
    assert "pip install pyoidn" in refused("--model", weights)


def test_it_is_a_method_of_evaluate():
    (method,) = choose(["default-oidn"])
    step, history = method.step("cpu", "fp32"), None
    for frame in make_frames(3):
        image, history = step(frame, history)
    assert image.isfinite().all() and len(history.recent) == 3
    assert "paper-oidn" not in {m.name for m in choose(["all"])}


@pytest.mark.parametrize("name", ["default-oidn", "hybrid"])
def test_its_own_picture_as_history_neither_drifts_nor_glows(name):
    """Over forty frames the error stays; when the light goes out, so does the picture."""
    (method,) = choose([name])
    step, history, errors = method.step("cpu", "fp32"), None, []
    frames = make_frames(40, H=48, W=64)
    with torch.inference_mode():
        for frame in frames:
            image, history = step(frame, history)
            errors.append((image - frame.reference).square().mean().item())
        assert np.mean(errors[-8:]) < 1.1 * np.mean(errors[8:16])
        for frame in make_frames(46, H=48, W=64)[40:]:
            image, history = step(replace(frame, radiance=torch.zeros_like(frame.radiance)), history)
        assert image.max() < 1e-3 * frames[-1].reference.mean()
