"""`denoise --oidn`: OIDN's picture of the averaged light, mixed into the network's."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import Stop, make_frames, stop_after, write_sequence

from rtdenoise import Denoiser, models
from rtdenoise.baselines import Oidn
from rtdenoise.cli.main import main
from rtdenoise.errors import InputError
from rtdenoise.evaluate.registry import choose
from rtdenoise.models import AccumulatedKPNConfig
from rtdenoise.run import opinion
from rtdenoise.run.backends import TorchBackend
from rtdenoise.run.denoise import Options, denoise

SMALL = AccumulatedKPNConfig(widths=(8, 12, 4, 8, 4), edge_kernel=3)


@pytest.fixture
def weights(tmp_path):
    torch.manual_seed(0)
    models.save(models.create(SMALL), tmp_path / "w.safetensors")
    return str(tmp_path / "w.safetensors")


def test_it_is_between_both_pictures(weights):
    """Of light that is constant both know it."""
    image, picture = torch.full((1, 3, 8, 8), 2.0), torch.full((1, 3, 8, 8), 8.0)
    found = opinion.mixed(image, picture, 0.5)
    assert ((found > 2) & (found < 8)).all()
    assert torch.allclose(opinion.mixed(image, image, 0.3), image, rtol=1e-5)
    assert torch.allclose(opinion.mixed(8 * image, 8 * picture, 0.5), 8 * found, rtol=1e-5)  # at any exposure


def test_oidn_gets_the_average_and_history_stays_the_networks(weights, monkeypatch):
    seen = []

    class Recorder(Oidn):
        def step(self, frame, history=None):
            seen.append(frame)
            return super().step(frame, history)

    monkeypatch.setattr(opinion, "Oidn", Recorder)
    alone = TorchBackend(weights, "cpu", "fp32", recent=opinion.RECENT)
    asked, history, before = TorchBackend(weights, "cpu", "fp32", oidn=True), None, None
    for frame in make_frames(4):
        plain, before = alone.step(alone.prepare(frame), before)
        image, history = asked.step(asked.prepare(frame), history)
        assert not np.allclose(image, plain, rtol=1e-3)
        for name, tensor in before.layers().items():
            words = tensor.shape[1]  # kept frames have albedo besides
            assert torch.equal(tensor, history.layers()[name][:, :words])
        expected = opinion.mixed(torch.from_numpy(plain), Oidn().step(seen[-1])[0], 0.3)
        assert np.allclose(image, expected.numpy(), rtol=1e-4, atol=1e-5)
    noise, averaged = (x - frame.reference for x in (frame.radiance, seen[-1].radiance))
    assert averaged.square().mean() < 0.6 * noise.square().mean()
    assert len(history.recent) == 4


def test_light_that_one_frame_has_seen_is_evened_with_the_networks_image(weights, monkeypatch, tmp_path):
    """Not in the first frame, where all of it is as noisy; in the second, everything has come much nearer."""
    seen = []
    monkeypatch.setattr(Oidn, "step", lambda self, frame, history=None: (seen.append(frame) or frame.radiance, None))
    torch.manual_seed(0)
    models.save(models.create(replace(SMALL, recent=opinion.RECENT)), tmp_path / "recent.safetensors")
    asked, plain = (TorchBackend(str(tmp_path / "recent.safetensors"), "cpu", "fp32", oidn=x) for x in (True, False))
    first, second = make_frames(2)
    second = replace(second, depth=second.depth / 9)
    history = before = None
    for frame in (first, second):
        image, before = plain.step(plain.prepare(frame), before)
        history = asked.step(asked.prepare(frame), history)[1]
    assert torch.equal(seen[0].radiance, first.radiance)
    expected = 0.8 * second.radiance + 0.2 * torch.from_numpy(image)
    assert torch.allclose(seen[1].radiance, expected, rtol=1e-4, atol=1e-5)


def test_an_interrupted_run_goes_on_to_the_bit(weights, tmp_path):
    shot = write_sequence(tmp_path / "shot", make_frames(6))
    options = Options(model=weights, precision="fp32", float32=True, oidn=True)
    denoise(str(shot), tmp_path / "whole", options)

    with pytest.raises(Stop):
        denoise(str(shot), tmp_path / "parts", options, on_frame=stop_after(3))
    assert denoise(str(shot), tmp_path / "parts", options).skipped == 3
    for path in sorted((tmp_path / "whole").glob("*.exr")):
        assert path.read_bytes() == (tmp_path / "parts" / path.name).read_bytes()
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
