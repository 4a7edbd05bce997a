"""Training: it learns, repeats itself to the bit, resumes to the same curve, and refuses what does not fit."""

import json
import math
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from synthetic import TINY, make_frames, write_clips

from rtdenoise.data.clip_file import RADIANCE, clip_path, read_layers, write_clip
from rtdenoise.data.clips import ClipDataset
from rtdenoise.errors import InputError
from rtdenoise.exposure import exposure
from rtdenoise.files import dumps
from rtdenoise.frame import stack
from rtdenoise.models import PRESETS, STILLS, create, load, read, save
from rtdenoise.ops import warp
from rtdenoise.training import tasks
from rtdenoise.training.augment import MAX_RELIGHT, MAX_SHADE, augment, relight, shade
from rtdenoise.training.batches import TrainingSet
from rtdenoise.training.batches import clips as batch
from rtdenoise.training.loop import train
from rtdenoise.training.trainer import TrainConfig, Trainer


def test_augmentation_turns_motion_with_the_picture():
    """In every mirror image the previous reference, warped, must still be the current one (the moving square is
    rigid)."""
    frames = make_frames(2, noise=0.0)
    for seed in range(16):
        before, now = augment(frames, np.random.default_rng(seed))
        inside = now.depth == 3
        error = (warp(before.reference, now.motion) - now.reference).abs() * inside
        assert error.max() < 1e-5, seed
        assert now.radiance.shape[2] in (24, 32)


def test_augmentation_is_a_function_of_the_generator():
    frames = make_frames(2)
    first, second = (augment(frames, np.random.default_rng(4)) for _ in range(2))
    assert all(torch.equal(a.radiance, b.radiance) for a, b in zip(first, second, strict=True))
    shapes = {tuple(augment(frames, np.random.default_rng(s))[0].radiance.shape) for s in range(8)}
    assert len(shapes) == 2  # some are transposed


def test_a_batch_has_the_layers_that_all_its_clips_have():
    plain = make_frames(1)[0]
    more = replace(plain, samples=torch.ones_like(plain.depth), components=torch.cat([plain.radiance] * 2, 1) / 2)
    for frames in ((plain, more), (more, plain)):
        assert {name for name, _ in stack(list(frames)).layers()} == {name for name, _ in plain.layers()}
    assert stack([more, more]).components.shape[:2] == (2, 6)


def test_relighting_multiplies_noise_and_reference_alike():
    frames = make_frames(6)
    untouched, least, most = set(), 1.0, 1.0
    for seed in range(16):
        relit = relight(frames, np.random.default_rng(seed))
        ratios = [now.reference / was.reference for now, was in zip(relit, frames, strict=True)]
        for now, was, ratio in zip(relit, frames, ratios, strict=True):
            torch.testing.assert_close(now.radiance, was.radiance * ratio)
            assert all(getattr(now, name) is getattr(was, name) for name in ("albedo", "normal", "depth", "motion"))
        least, most = min(least, *(r.min().item() for r in ratios)), max(most, *(r.max().item() for r in ratios))
        untouched.add(sum((ratio == 1).all().item() for ratio in ratios))  # frames before it begins
        assert any(not torch.allclose(a, b) for a, b in pairwise(ratios))  # it changes
    assert 2**-MAX_RELIGHT <= least < 0.5 and 2 < most <= 2**MAX_RELIGHT
    assert 0 in untouched and len(untouched) > 2


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    return write_clips(tmp_path_factory.mktemp("clips"), range(5))


@pytest.fixture(scope="module")
def other_clips(tmp_path_factory):
    return write_clips(tmp_path_factory.mktemp("validation"), range(5, 7))


@pytest.fixture
def config(clips, other_clips, tmp_path, monkeypatch):
    monkeypatch.setitem(PRESETS, "tiny", TINY)
    return TrainConfig(
        data=(clips,),
        out=tmp_path / "run",
        val=other_clips,
        model="tiny",
        steps=6,
        batch=2,
        frames=3,
        size=16,
        amp=False,
        validate_every=3,
    )


def log(run):
    return [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]


def test_clips_of_many_objects(tmp_path):
    layers = {name: np.ones((8, 8, 3), np.float32) for name in (*RADIANCE, "albedo", "normal")}
    layers |= {"depth": np.ones((8, 8, 1)), "motion": np.zeros((8, 8, 2)), "motion_next": np.zeros((8, 8, 2))}
    ids = np.arange(64, dtype=np.float32).reshape(8, 8, 1)
    write_clip(clip_path(tmp_path, 0), [layers | {"id": 1000 * ids}], {})
    assert np.array_equal(ClipDataset(tmp_path).load(0)[0].id[0, 0].numpy(), 1000 * ids[..., 0])
    with pytest.raises(InputError, match="object 126000: clips number at most 65535 objects"):
        write_clip(clip_path(tmp_path, 1), [layers | {"id": 2000 * ids}], {})


def test_a_run_explains_itself_and_its_weights_denoise(config):
    weights = train(config)
    assert json.loads((config.out / "config.json").read_text())["options"]["steps"] == 6
    rows = log(config.out)
    assert [row["step"] for row in rows if "validation" in row] == [3, 6]
    assert {"loss", "spatial", "temporal", "occlusion", "grad_norm", "lr", "seconds"} <= rows[-2].keys()
    denoiser = load(weights)
    assert denoiser.config == TINY
    assert denoiser.step(make_frames(1)[0])[0].isfinite().all()


def test_what_is_not_a_number_is_null_in_the_log(config, monkeypatch):
    nothing = {"noisy": 10.0, "denoised": math.inf, "denoised_uncovered": math.nan}  # no frame has uncovered regions
    monkeypatch.setattr(tasks, "DENOISING", replace(tasks.DENOISING, validate=lambda *_: nothing))
    train(replace(config, steps=3))
    text = (config.out / "log.jsonl").read_text()
    assert "NaN" not in text and "Infinity" not in text
    (row,) = [row for row in log(config.out) if "validation" in row]
    assert row["validation"] == {"noisy": 10.0, "denoised": None, "denoised_uncovered": None}
    assert dumps({"a": (1, float("nan")), "b": [True, "NaN"]}) == '{"a": [1, null], "b": [true, "NaN"]}'


def test_tensorboard_has_the_log_also_of_a_resumed_run(config):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    config = replace(config, tensorboard=True)
    train(config)
    (config.out / "log.jsonl").open("a").write('{"step": 7, "loss": 1.0}\n')  # as after a kill
    train(config)
    events = EventAccumulator(str(config.out / "tensorboard"))
    events.Reload()
    rows = [row for row in log(config.out) if "loss" in row]
    assert [row["step"] for row in rows] == [event.step for event in events.Scalars("loss")]
    assert [row["loss"] for row in rows] == pytest.approx([event.value for event in events.Scalars("loss")])
    assert "validation/denoised" in events.Tags()["scalars"]


def test_tensorboard_that_is_missing_is_one_line(config, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(InputError, match=r"pip install 'rtdenoise\[tensorboard\]'"):
        train(replace(config, tensorboard=True))


def test_same_seed_same_weights_other_seed_others(config, tmp_path):
    path, repeated = train(config), train(replace(config, out=tmp_path / "again"))
    first, again = load(path).state_dict(), load(repeated).state_dict()
    assert path.read_bytes() == repeated.read_bytes()
    other = load(train(replace(config, out=tmp_path / "other", seed=1))).state_dict()
    assert all(torch.equal(first[k], again[k]) for k in first)
    assert not all(torch.equal(first[k], other[k]) for k in first)


def interrupt_at_four(config, monkeypatch):
    """Begin a run, and stop it after four steps."""
    step = Trainer.train_step

    def interrupted(self, clip):
        row = step(self, clip)
        if row["step"] == 4:
            signal.raise_signal(signal.SIGTERM)
        return row

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "train_step", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train(config)


def test_a_run_in_a_thread(config):
    """As of a program with windows: signals are the main thread's."""
    with ThreadPoolExecutor(1) as thread:
        path = thread.submit(train, replace(config, steps=1)).result()
    assert path.exists()


@pytest.mark.parametrize("optimiser", ["adam", "muon"])
def test_a_killed_run_resumes_to_the_same_weights(config, tmp_path, monkeypatch, optimiser):
    config = replace(config, optimiser=optimiser)
    whole = load(train(config)).state_dict()
    interrupted = replace(config, out=tmp_path / "interrupted")
    interrupt_at_four(interrupted, monkeypatch)
    assert torch.load(interrupted.out / "checkpoint.pt", weights_only=True)["step"] == 4
    with (interrupted.out / "log.jsonl").open("a") as rows:  # as after a kill later than the last checkpoint
        rows.write('{"step": 5, "loss": 1.0}\n{"step": 6, "lo')
    resumed = load(train(interrupted)).state_dict()
    assert all(torch.equal(whole[k], resumed[k]) for k in whole)
    assert [row["step"] for row in log(interrupted.out)] == [row["step"] for row in log(config.out)]


def test_occlusion_loss_comes_in_the_second_half(config):
    trainer = Trainer(config)
    data = ClipDataset(*config.data)
    rows = [trainer.train_step(batch(data, config, step)) for step in range(6)]
    assert all(row["occlusion"] == 0 for row in rows[:3])
    assert all(row["occlusion"] > 0 for row in rows[3:])
    off = Trainer(replace(config, occlusion_loss=False))
    assert all(off.train_step(batch(data, config, step))["occlusion"] == 0 for step in range(6))


@pytest.mark.parametrize("optimiser", ["adam", "muon"])
def test_it_learns(config, optimiser):
    trainer = Trainer(replace(config, optimiser=optimiser, steps=10_000, lr=0.05))  # warming up: 0.02 in the last step
    clip = batch(ClipDataset(*config.data), config, 0)
    losses = [trainer.train_step(clip)["loss"] for _ in range(80)]
    assert np.mean(losses[-5:]) < 0.85 * losses[0]


@pytest.mark.parametrize(
    ("change", "expected"),
    [({"loss_exposure": 0.0}, "loss_exposure: expected more than 0, got 0"),
     ({"loss_exposure": math.nan}, "loss_exposure: expected more than 0, got nan"),
     ({"huber": -1.0}, "huber: expected 0 or more, got -1"),
     ({"checkpoint_minutes": math.nan}, "checkpoint_minutes: expected 0 or more, got nan"),
     ({"model": "hybrid"}, "init: hybrid leaves its kernels as they are; expected weights .* --init hybrid")],
)  # fmt: skip
def test_options_that_cannot_train_are_refused(config, change, expected):
    with pytest.raises(InputError, match=expected):
        train(replace(config, **change))
    assert not Path(config.out).exists()


def test_a_step_with_a_loss_that_is_not_finite_is_skipped(config):
    """Even where all of its gradients are finite."""
    trainer = Trainer(config)
    before, loss = [p.clone() for p in trainer.model.parameters()], trainer.task.loss

    def broken(*arguments):
        total, terms = loss(*arguments)
        return total + math.nan, terms

    trainer.task = replace(trainer.task, loss=broken)
    row = trainer.train_step(batch(ClipDataset(*config.data), config, 0))
    assert math.isfinite(row["grad_norm"]) and row["skipped"] == 1
    assert all(torch.equal(a, b) for a, b in zip(before, trainer.model.parameters(), strict=True))


def test_a_poisoned_clip_is_skipped_counted_and_named(config, tmp_path, monkeypatch, capsys):
    load_clip = ClipDataset.load

    def poisoned(self, index, **options):
        frames = load_clip(self, index, **options)
        return [replace(f, reference=f.reference * float("nan")) for f in frames] if index == 2 else frames

    monkeypatch.setattr(ClipDataset, "load", poisoned)
    weights = train(replace(config, val=None, batch=1, steps=5))  # one epoch: each clip once
    assert all(p.isfinite().all() for p in load(weights).parameters())
    skipped = [row for row in log(config.out) if row["grad_norm"] is None]
    assert len(skipped) == 1 and skipped[0]["loss"] is None and log(config.out)[-1]["skipped"] == 1
    assert skipped[0]["clips"] == [str(clip_path(config.data[0], 2))]
    assert "1 steps skipped" in capsys.readouterr().out
    train(replace(config, out=tmp_path / "stills", val=None, batch=1, frames=1, steps=9, stills=config.data))
    assert [row["clips"] for row in log(tmp_path / "stills") if row["grad_norm"] is None] == 2 * [skipped[0]["clips"]]


def test_broken_weights_end_the_run(config, monkeypatch):
    step = Trainer.train_step

    def break_weights(self, clip):
        if self.step == 3:
            next(self.model.parameters()).data.fill_(math.nan)
        return step(self, clip)

    monkeypatch.setattr(Trainer, "train_step", break_weights)
    with pytest.raises(InputError, match=r"20 steps in turn without a finite loss .* --init .*weights.safetensors"):
        train(replace(config, steps=100))
    assert log(config.out)[-1]["step"] == 22  # and the next was the last
    assert all(p.isfinite().all() for p in load(config.out / "weights.safetensors").parameters())  # the best, of step 3


def test_every_clip_is_seen_once_an_epoch(config):
    data = ClipDataset(*config.data)
    one = replace(config, batch=1, size=24, frames=4)
    # Tints cancel in this ratio, and the sum over a whole clip is the same backwards.
    noise = [sum((f.radiance / f.reference).mean().item() for f in batch(data, one, step)) for step in range(10)]
    means = [round(mean, 5) for mean in noise]
    assert len(set(means[:5])) == 5 and set(means[:5]) == set(means[5:])


def test_every_second_step_takes_stills(config, other_clips):
    config = replace(config, stills=(other_clips,), val=None, batch=2, frames=3)
    data = TrainingSet.open(config)
    taken = [data.batch(batch, config, step) for step in range(6)]
    assert [(len(frames), len(frames[0].radiance)) for frames in taken] == [(3, 2), (1, 6)] * 3
    without = [batch(data.clips, config, step) for step in range(3)]  # the clips come in the order of a run without
    assert all(torch.equal(a[0].radiance, b[0].radiance) for a, b in zip(taken[::2], without, strict=True))
    assert train(config).is_file()
    for wrong in ({}, {"stills": (), "lead_in": 3}):
        with pytest.raises(InputError, match="combiner takes windows of frames"):
            train(replace(config, model="combiner", frames=5, **wrong))
    with pytest.raises(InputError, match="scenes that are in the training clips too"):
        train(replace(config, val=other_clips))


def test_a_lead_in_gives_history_and_counts_for_nothing(tmp_path, config):
    """Its references are never read, and the loss is that of the same frames with the history passed on by hand."""
    write_clips(tmp_path, range(1), lead_in=3)
    config = replace(config, data=(tmp_path,), val=None, batch=1, size=24, frames=4, lead_in=8)
    data = ClipDataset(tmp_path)
    taken = batch(data, config, 0)
    assert len(taken) == 7 and len(batch(data, replace(config, lead_in=0), 0)) == 4
    loss = tasks.denoiser_loss(Trainer(config).model, taken, config, 0)[0]
    lit = [replace(f, reference=f.radiance, reference_half=f.radiance) for f in taken[:3]] + taken[3:]
    torch.testing.assert_close(tasks.denoiser_loss(Trainer(config).model, lit, config, 0)[0], loss)
    assert tasks.denoiser_loss(Trainer(config).model, taken[3:], config, 0)[0] != loss
    history, total, previous = None, 0.0, None
    model = Trainer(config).model
    for i, frame in enumerate(taken):
        image, history = model.step(frame, history)
        if i >= 3:
            scale = config.loss_exposure * exposure(frame.reference)
            total += model.loss(image, frame, previous, None, scale, config.huber).total.item() / 4
            previous = image, frame.reference
    assert total == pytest.approx(loss.item(), rel=1e-4)
    assert train(config).is_file()
    with pytest.raises(InputError, match="lead_in: expected 0 to"):
        train(replace(config, lead_in=-1))


def test_light_moves_through_a_lead_in_too(tmp_path, config):
    write_clips(tmp_path, range(1), lead_in=3)
    config = replace(config, data=(tmp_path,), val=None, batch=1, size=24, frames=4, lead_in=3)
    moved = []
    for step in range(4):
        lit, plain = (batch(ClipDataset(tmp_path), replace(config, relight=share), step) for share in (1.0, 0.0))
        moved.append([not torch.equal(a.radiance, b.radiance) for a, b in zip(lit, plain, strict=True)])
    assert all(any(frames) for frames in moved) and any(any(frames[:3]) for frames in moved)


def test_clips_of_too_few_or_too_many_samples_are_left_out(tmp_path, config):
    layers = {n: layer[0].transpose(1, 2, 0) for n, layer in read_layers(ClipDataset(*config.data).paths[0]).items()}
    for index, spp in enumerate((1, 4, 16)):
        write_clip(clip_path(tmp_path, index), [layers], {"spp": spp})
    config = replace(config, data=(tmp_path,), val=None)
    ranges = {(1, None): 3, (4, None): 2, (16, None): 1, (1, 1): 1, (1, 4): 2, (4, 15): 1}
    found = {spp: len(TrainingSet.open(replace(config, least_spp=spp[0], most_spp=spp[1])).clips) for spp in ranges}
    assert found == ranges
    for spp, told in (((32, None), "no clip has 32 and more samples"), ((5, 8), "no clip has 5 to 8 samples")):
        with pytest.raises(InputError, match=told):
            TrainingSet.open(replace(config, least_spp=spp[0], most_spp=spp[1]))
    with pytest.raises(InputError, match="most_spp: expected 4"):
        train(replace(config, least_spp=4, most_spp=2))


def test_the_root_of_the_loss_weighs_clips_of_small_errors_more(config):
    """With two items of errors a and b, the gradient of √a + √b is that of each over its own root."""
    clip = batch(ClipDataset(*config.data), config, 0)
    plain, root = (
        tasks.denoiser_loss(Trainer(c).model, clip, c, 0)[0] for c in (config, replace(config, loss_power=0.5))
    )
    alone = [tasks.denoiser_loss(Trainer(config).model, [frame.map(lambda x, i=i: x[i : i + 1]) for frame in clip],
                                 config, 0)[0] for i in range(config.batch)]  # fmt: skip
    torch.testing.assert_close(plain, torch.stack(alone).mean())
    torch.testing.assert_close(root, (torch.stack(alone) + tasks.LEAST_LOSS).sqrt().mean())
    with pytest.raises(InputError, match="loss_power: expected more than 0 and 1 at most, got 2"):
        train(replace(config, loss_power=2.0))


@pytest.mark.parametrize("seed", range(6))
def test_shading_multiplies_noise_and_reference_alike(seed):
    frame = make_frames(1, H=40, W=56, seed=seed)[0]
    (shaded,) = shade([frame], np.random.default_rng(seed))
    factor = shaded.reference / frame.reference
    torch.testing.assert_close(shaded.radiance, frame.radiance * factor)
    assert factor.max() <= 1.0001 and factor.min() >= 2**-MAX_SHADE * 0.999 and factor.std() > 0.02
    torch.testing.assert_close(factor[:, 0], factor[:, 2])
    assert shaded.albedo is frame.albedo and shaded.normal is frame.normal


def test_a_run_from_before_there_was_an_option_goes_on(config):
    """Where it has its default now."""
    train(config)
    path = config.out / "config.json"
    stored = json.loads(path.read_text())
    for option in ("shade", "loss_power"):
        del stored["options"][option]
    path.write_text(json.dumps(stored))
    train(config)
    with pytest.raises(InputError, match=r"started with shade = 0\.0, not 0\.5"):
        train(replace(config, shade=0.5))
    path.write_text('{"options": {}}')
    with pytest.raises(InputError, match="not the options of a run"):
        train(config)


def test_what_does_not_fit_is_refused(config, tmp_path):
    train(config)
    with pytest.raises(InputError, match="started with lr"):
        train(replace(config, lr=1.0))
    with pytest.raises(InputError, match="started with optimiser = adam, not muon"):
        train(replace(config, optimiser="muon"))
    for wrong in ("model", "motion", "device", "signal", "optimiser"):
        with pytest.raises(InputError, match=f"unknown {wrong} 'x'"):
            train(replace(config, **{wrong: "x"}))
    with pytest.raises(InputError, match="steps: expected 1 or more, got 0"):
        train(replace(config, steps=0))
    for name in ("steps", "batch", "frames", "size", "validate_every", "warmup"):
        with pytest.raises(InputError, match=f"{name}: expected .* at most, got 1000"):
            train(replace(config, **{name: 10**30}))
    for wrong in ({"seed": -1}, {"seed": 10**30}, *({"lr": lr} for lr in (0.0, -1.0, math.nan, math.inf, 1e300))):
        with pytest.raises(InputError, match=f"{min(wrong)}: expected "):
            train(replace(config, **wrong))
    with pytest.raises(InputError, match=r"relight: expected a share from 0 to 1, got 30"):
        train(replace(config, relight=30))
    with pytest.raises(InputError, match="no clips"):
        train(replace(config, data=(tmp_path,)))
    with pytest.raises(InputError, match="scenes that are in the training clips too, such as generator 1, seed 0"):
        train(replace(config, val=config.data[0]))
    for wrong, expected in (({"size": 512}, "at least"), ({"init": tmp_path / "none"}, "no model")):
        with pytest.raises(InputError, match=expected):
            train(replace(config, out=tmp_path / "big", **wrong))
        assert not (tmp_path / "big").exists()  # a failed start leaves nothing that its correction would trip over


def test_clips_that_do_not_fit_are_refused_before_there_is_a_run(config, tmp_path):
    """Whichever they are, not only those of the first batch."""
    facts = {"clip": json.dumps({"seed": 8, "generator": 1})}
    small = write_clips(tmp_path / "small", [9], size=20)
    beauty = write_clips(tmp_path / "beauty", [7, 8])
    for path in beauty.iterdir():
        save_file({k: v for k, v in load_file(path).items() if not k.startswith("indirect")}, path, facts)
    poisoned = write_clips(tmp_path / "poisoned", [7, 8])
    layers = load_file(clip_path(poisoned, 1))
    layers["indirect_reference"][2, 0, 3, 3] = math.nan
    save_file(layers, clip_path(poisoned, 1), facts)
    for change, message in (
        ({"data": (*config.data, small), "size": 24}, "small/clip_000000.*expected at least 3 frames of 24×24"),
        ({"data": (*config.data, small), "size": 24}, "found 4 of 20×20; take fewer --frames or a smaller --size"),
        ({"data": (*config.data, beauty)}, "beauty/clip_000000.*has no signal 'indirect'"),
        ({"stills": (beauty,)}, "beauty/clip_000000.*has no signal 'indirect'"),
        ({"val": beauty}, "beauty/clip_000000.*has no signal 'indirect'"),
        ({"val": poisoned}, "poisoned/clip_000001.*reference is not finite"),
    ):
        with pytest.raises(InputError, match=message):
            train(replace(config, **change))
        assert not config.out.exists()


def test_the_best_validation_is_what_ships(config, monkeypatch):
    """A run that gets worse after its first validation keeps the weights of that one."""
    scores = iter([20.0, 19.0])
    found = {"noisy": 9.0, "denoised_uncovered": math.nan}
    scored = replace(tasks.DENOISING, validate=lambda *_: found | {"denoised": next(scores)})
    monkeypatch.setattr(tasks, "DENOISING", scored)
    with safe_open(train(config), framework="np") as file:
        assert json.loads(file.metadata()["training"])["reached_step"] == 3


def test_the_best_weights_are_not_overwritten_without_validation(config):
    best = train(config).read_bytes()
    with pytest.raises(InputError, match=r"best validation so far.*--val"):
        train(replace(config, val=None))
    assert train(config).read_bytes() == best
    (config.out / "weights.safetensors").unlink()
    train(replace(config, val=None))
    assert load(config.out / "weights.safetensors")


def test_a_resumed_run_does_without_the_weights_that_it_began_with(config, tmp_path, monkeypatch):
    first = train(config)
    whole = load(train(replace(config, out=tmp_path / "whole", init=first))).state_dict()
    interrupted = replace(config, out=tmp_path / "interrupted", init=first)
    interrupt_at_four(interrupted, monkeypatch)
    first.unlink()
    resumed = load(train(interrupted)).state_dict()
    assert all(torch.equal(whole[k], resumed[k]) for k in whole)
    with pytest.raises(InputError, match="no model"):
        train(replace(interrupted, out=tmp_path / "other"))


def test_training_starts_from_weights(config, tmp_path):
    first = train(config)
    again = Trainer(replace(config, init=first))
    assert all(torch.equal(a, b) for a, b in zip(again.model.parameters(), read(first).parameters(), strict=True))
    assert all(p.requires_grad for p in again.model.parameters())
    with pytest.raises(InputError, match="does not grow into paper"):
        Trainer(replace(config, init=first, model="paper"))
    save(create(STILLS["afgsa-small"]), still := tmp_path / "still.safetensors")
    with pytest.raises(InputError, match="does not grow into default"):  # it knows no motion
        Trainer(replace(config, init=still, model="default"))


def test_a_cut_starts_anew(config):
    """With history dropped at the last frame, the loss there is that of a first frame."""
    clip = batch(ClipDataset(*config.data), replace(config, frames=2), 0)
    always = Trainer(replace(config, frames=2, cuts=1.0)).train_step(clip)
    singles = [Trainer(replace(config, frames=1)).train_step([frame]) for frame in clip]
    assert always["temporal"] == 0
    assert always["spatial"] == pytest.approx(sum(row["spatial"] for row in singles) / 2, rel=1e-5)


def test_two_processes_take_the_steps_of_one(config, tmp_path):
    """torchrun with gloo: the same global batch, losses, gradients and validations, up to the order of additions."""
    script, environment = Path(__file__).parent / "run_training.py", os.environ | {"OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", script,
               *config.data, config.val, tmp_path / "two"]  # fmt: skip
    result = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert result.returncode == 0, result.stderr
    train(replace(config, batch=4))
    one, two = log(config.out), log(tmp_path / "two")
    assert [row["step"] for row in one] == [row["step"] for row in two]
    for a, b in zip(one, two, strict=True):
        for of_step in ("loss", "grad_norm"):
            assert a.get(of_step, 0.0) == pytest.approx(b.get(of_step, 0.0), rel=1e-4)
        assert a.get("validation", {}) == pytest.approx(b.get("validation", {}), rel=1e-4)
