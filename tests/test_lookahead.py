"""`denoise --lookahead`: frames after count as those before do; runs, cuts and programs; what is refused."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import Stop, behind_glass, make_frames, stop_after, write_sequence
from test_denoise import pixels

from rtdenoise import Denoiser, models
from rtdenoise.errors import InputError
from rtdenoise.evaluate import evaluate, outputs
from rtdenoise.evaluate.registry import choose
from rtdenoise.frame import History, Known, reverse
from rtdenoise.models import AccumulatedKPNConfig, moved_light, past
from rtdenoise.models.past import turning
from rtdenoise.ops.pixels import demodulate
from rtdenoise.run.denoise import Options, denoise
from rtdenoise.run.lookahead import linked
from rtdenoise.run.once import Once
from rtdenoise.run.options import AHEAD
from rtdenoise.run.tiles import Tiled
from rtdenoise.run.torch_backend import TorchBackend
from rtdenoise.sanitise import sanitise
from rtdenoise.splat import completed

SMALL = AccumulatedKPNConfig(widths=(8, 12, 4, 8, 4), edge_kernel=3, recent=3)
FEATURES = ("albedo", "normal", "depth", "motion", "motion_next")


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    models.save(models.create(SMALL), path)
    return str(path)


@pytest.fixture
def frames():
    return [sanitise(frame) for frame in make_frames(6)]


def light(frame):
    return demodulate(frame.radiance, frame.albedo, frame.depth)


def test_a_first_frame_has_the_light_of_those_after(frames):
    known = Known(sanitised=True, ahead=tuple(frames[1:3]))
    config = replace(SMALL, footprint=True)
    found = past.reprojected(config, frames[0], light(frames[0]), None, known)
    assert found.length.max() > 1.5 and not found.on_screen.any() and found.later is not None
    still = frames[0].motion_next.abs().amax(1, keepdim=True) == 0
    seen = still & (found.length > 1.9)
    assert seen.float().mean() > 0.2  # the wall, where it is not covered
    mean, seen = (light(frames[1]) + light(frames[2])) / 2, seen.expand(-1, 3, -1, -1)
    torch.testing.assert_close(found.light[seen], mean[seen], rtol=0.02, atol=0.02)


def test_time_runs_both_ways(frames):
    """The frames after, looked up, are what the history of the reversed sequence would be."""
    config = replace(SMALL, footprint=True, recent=2)
    known = Known(sanitised=True, ahead=tuple(frames[3:5]))
    forward = past.reprojected(config, frames[2], light(frames[2]), None, known)
    later = past.later(config, frames[2], known)
    history = replace(later, radiance=frames[3].radiance, mean_albedo=frames[3].albedo)
    backward = past.reprojected(config, reverse(frames[2]), light(frames[2]), history, Known(sanitised=True))
    for name in ("light", "length", "footprint", "footprint_count"):
        torch.testing.assert_close(getattr(forward, name), getattr(backward, name))


def test_both_sides_are_joined_by_how_many_frames_they_are(frames, monkeypatch):
    monkeypatch.setattr(past, "_relit", lambda found, *_: found)  # as they are joined
    network = models.create(SMALL).eval()
    with torch.no_grad():
        _, history = network.step(frames[0])
        _, history = network.step(frames[1], history)
    ahead = tuple(frames[3:5])
    before, after, both = (
        past.reprojected(SMALL, frames[2], light(frames[2]), h, Known(sanitised=True, ahead=a))
        for h, a in ((history, ()), (None, ahead), (history, ahead))
    )
    torch.testing.assert_close(both.length, before.length + after.length)
    torch.testing.assert_close(both.light * both.length, before.light * before.length + after.light * after.length)
    assert torch.equal(both.output, before.output) and torch.equal(both.uncovered, before.uncovered)


def test_of_many_frames_those_nearest_count():
    frame = make_frames(1)[0]
    history = History(frame.radiance, frame.motion, frame.depth, frame.normal, recent=tuple(torch.arange(8).split(1)))
    for ahead, before in ((0, 8), (2, 8), (4, 8), (6, 6), (8, 8), (16, 8)):
        asked = past.nearest(history, Known(ahead=(frame,) * ahead))
        assert asked.recent == history.recent[:before]


@pytest.mark.parametrize("side", [0, 64])
def test_frames_that_wait_are_compared_and_kept_once(monkeypatch, side):
    """The last one again, once the one after it is there. The picture is the same as where each step does so anew, in
    tiles up to their rims."""
    compared, packed, ahead, coming = [], [], 4, past.coming
    monkeypatch.setattr(past, "turning", lambda a, b, find=past.turning: compared.append(a.number) or find(a, b))
    monkeypatch.setattr(past, "coming", lambda config, a, *how: packed.append(a.number) or coming(config, a, *how))
    backend, network = TorchBackend("hybrid", "cpu", "fp32", lookahead=ahead), models.load("hybrid", precision="fp32")
    if side:
        backend._step = backend._whole = Tiled(backend.network, side).step
    shot, history, expected = [backend.prepare(frame) for frame in make_frames(8)], None, None
    for i, frame in enumerate(shot):
        image, history = backend.denoise(frame, history, tuple(shot[i + 1 : i + 1 + ahead]))
        assert compared == [*range(1, min(i + ahead, 7))]
        if not side:
            first = i + ahead - 1 if i else 1
            assert packed == [*range(min(first, 7), min(i + ahead, 7) + 1)] * (i < 7)
            packed.clear()
            known = Known(sanitised=True, ahead=tuple(shot[i + 1 : i + 1 + ahead]), waits=True)
            with torch.inference_mode(), monkeypatch.context() as patch:
                patch.setattr(past, "turning", turning)
                patch.setattr(past, "coming", coming)
                alone, expected = network.step(frame, expected, known)
            assert torch.equal(image, alone)


def test_frames_that_share_a_layer_are_others(frames):
    """As where a program passes the same depth again and a screen shows something else."""
    found = Once(lambda a, b: a.albedo - b.albedo, 4)
    first, second, third = (replace(frame, depth=frames[0].depth) for frame in frames[:3])
    assert not torch.equal(found(first, second), found(second, third))
    darker = replace(first, radiance=first.radiance / 2)
    assert found(darker, second) is found(first, second)


@torch.inference_mode()
def test_what_was_just_uncovered_was_seen_again(frames):
    frame, network = frames[2], models.load("default")
    _, history = network.step(frames[0])
    _, history = network.step(frames[1], history)
    before, both = (
        past.reprojected(network.config, frame, light(frame), history, Known(sanitised=True, ahead=ahead))
        for ahead in ((), tuple(frames[3:5]))
    )
    new = before.uncovered
    assert new.any() and both.length[new].mean() > before.length[new].mean() + 1.5


def test_it_gains():
    results = evaluate(make_frames(8), ["hybrid", "hybrid-ahead1", "hybrid-ahead3"], skip=0)
    psnr = {result.method: result.errors["frame"]["psnr"] for result in results}
    assert psnr["hybrid"] + 0.2 < psnr["hybrid-ahead1"] < psnr["hybrid-ahead3"] - 0.2


@pytest.mark.parametrize("factor", [8.0, 2.0, 1.3, 0.1])
@pytest.mark.parametrize("name", ["default", "hybrid"])
def test_a_lamp_shows_no_earlier_than_it_is_switched(name, factor):
    """Nor does one that goes out: light that changes is told from noise."""
    network, switched, history, found = models.load(name, precision="fp32"), 4, None, []
    frames = [sanitise(frame) for frame in make_frames(switched + AHEAD, H=96, W=128)]
    frames = [replace(f, radiance=f.radiance * (factor if i >= switched else 1)) for i, f in enumerate(frames)]
    with torch.inference_mode():
        for i, frame in enumerate(frames[:switched]):
            ahead = tuple(frames[i + 1 : i + 1 + AHEAD])
            image, _ = network.step(frame, history, Known(sanitised=True, ahead=ahead))
            expected, _ = network.step(frame, history, Known(sanitised=True, ahead=tuple(frames[i + 1 : switched])))
            _, history = network.step(frame, history, Known(sanitised=True))
            found.append((image.mean() / expected.mean()).item())
    assert found == pytest.approx([1.0] * switched, abs=0.02)


def test_light_that_moves_in_a_pane_is_followed_from_the_first_frame_on():
    first, second = (sanitise(frame) for frame in behind_glass())
    back, there = moved_light.shifted(first, None, Known(ahead=(second,))).shift, first.motion_next
    assert there is not None
    expected = moved_light.shift_of(second, first.radiance, first.depth, ())
    assert expected is not None and back is not None
    moved = (expected.abs().sum(1) > 0) & (back.abs().sum(1) > 0)
    assert moved.any() and (back - expected).abs().amax(1)[moved].median() < 0.15


def test_tiles_are_as_the_whole(assert_images_close):
    frames = [sanitise(frame) for frame in make_frames(4, H=96, W=128)]
    network = models.load("hybrid", precision="fp32")
    whole, tiled = None, None
    for i, frame in enumerate(frames):
        known = Known(ahead=tuple(frames[i + 1 : i + 3]))
        a, whole = network.step(frame, whole, known)
        b, tiled = Tiled(network, 64).step(frame, tiled, known)
        assert_images_close(b.numpy(), a.numpy(), "float32 tiles")


@pytest.mark.parametrize(("killed", "lookahead"), [((1,), 2), ((2, 4), 2), ((5,), 2), ((1, 2), 4), ((5,), 4)])
def test_an_interrupted_run_goes_on_to_the_same_result(tmp_path, weights, killed, lookahead):
    still = [replace(frame, motion=0 * frame.motion, motion_next=0 * frame.motion) for frame in make_frames(6)]
    shot = write_sequence(tmp_path / "shot", still)
    options = Options(model=weights, float32=True, lookahead=lookahead)
    whole = denoise(str(shot), tmp_path / "whole", options)
    for count in killed:
        with pytest.raises(Stop):
            denoise(str(shot), tmp_path / "out", options, on_frame=stop_after(count))
    again = denoise(str(shot), tmp_path / "out", options)
    assert again.skipped == min(killed[-1], 6 - lookahead)  # the last ones lack frames after them: denoised again
    assert again.left_out == whole.left_out and any(whole.left_out.values())
    for i in range(6):
        name = f"frame.{i:04d}.exr"
        assert np.array_equal(pixels(tmp_path / "out" / name), pixels(tmp_path / "whole" / name)), name


@pytest.mark.parametrize("lookahead", [2, 3])
def test_files_programs_and_the_evaluation_give_the_same_pictures(tmp_path, weights, assert_images_close, lookahead):
    frames = make_frames(5)
    options = Options(model=weights, float32=True, lookahead=lookahead)
    denoise(str(write_sequence(tmp_path / "shot", frames)), tmp_path / "out", options)
    backend = TorchBackend(weights, "cpu", "auto", lookahead=lookahead)
    denoiser = Denoiser(weights, lookahead=lookahead)
    found = [denoiser(f.radiance, **{name: getattr(f, name) for name in FEATURES}) for f in frames]
    assert [image is None for image in found] == [i < lookahead for i in range(5)]
    found = [*found[lookahead:], *denoiser.flush()]
    assert len(found) == 5 and denoiser.flush() == [] and backend.config.recent == 3
    for i, image in enumerate(found):
        file = pixels(tmp_path / "out" / f"frame.{i:04d}.exr")[None]
        assert_images_close(image.numpy(), file, "float32 network")
    method = choose([f"default-ahead{lookahead}"])[0]
    measured = [output.image for output in outputs(method.step(), frames, method.delay)]
    shipped = Denoiser("default", lookahead=lookahead)
    shown = [shipped(f.radiance, **{name: getattr(f, name) for name in FEATURES}) for f in frames] + shipped.flush()
    for a, b in zip(measured, shown[lookahead:], strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("lookahead", [2, 3])
def test_no_frame_looks_beyond_a_cut(tmp_path, weights, lookahead):
    """Nor does a program's delay change there."""
    one, two = make_frames(3), make_frames(3, seed=5)
    two = [replace(f, number=f.number + 3, depth=3 * f.depth, normal=-f.normal) for f in two]
    summary = denoise(str(write_sequence(tmp_path / "both", [*one, *two])), tmp_path / "out",
                      Options(model=weights, float32=True, lookahead=lookahead))  # fmt: skip
    assert summary.cuts == [3]
    for name, frames in (("one", one), ("two", two)):
        denoise(str(write_sequence(tmp_path / name, frames)), tmp_path / f"out {name}",
                Options(model=weights, float32=True, lookahead=lookahead))  # fmt: skip
        for frame in frames:
            file = f"frame.{frame.number:04d}.exr"
            assert np.array_equal(pixels(tmp_path / "out" / file), pixels(tmp_path / f"out {name}" / file)), file
    denoiser = Denoiser(weights, lookahead=lookahead)
    found = [denoiser(f.radiance, **{n: getattr(f, n) for n in FEATURES}) is None for f in [*one, *two]]
    assert found == [i < lookahead for i in range(6)] and len(denoiser.flush()) == lookahead


def test_another_size_comes_after_what_waits(weights):
    """The plan of a size is made when all frames of the one before are done."""
    denoiser, done = Denoiser(weights, lookahead=2), []
    backend = denoiser._backend
    plan, real = backend.plan, backend.denoise
    backend.plan = lambda size, *rest: done.append(("plan", size)) or plan(size, *rest)
    backend.denoise = lambda frame, *rest: done.append(("frame", frame.size)) or real(frame, *rest)
    for frame in [*make_frames(3), *make_frames(2, H=40, W=48)]:
        denoiser(frame.radiance, **{name: getattr(frame, name) for name in FEATURES})
    assert done[:5] == [("plan", (24, 32)), *3 * [("frame", (24, 32))], ("plan", (40, 48))]
    assert [tuple(image.shape[2:]) for image in denoiser.flush()] == 2 * [(40, 48)]


def test_motion_forward_is_read_where_frames_after_are(weights):
    """Also by models whose history needs none of it."""
    frames = make_frames(3)
    for ahead, reads in ((0, False), (1, True)):
        backend = TorchBackend(weights, "cpu", "auto", lookahead=ahead)
        backend.network.config = replace(backend.config, motion="traditional")
        assert ("motion_next" in backend.plan((24, 32), 3, frames, {}).layers) == reads


def test_files_without_motion_next(tmp_path, weights):
    """It is approximated, as for the history."""
    frames = make_frames(4)
    shot = write_sequence(tmp_path / "shot", frames, without=("motion_next",))
    denoise(str(shot), tmp_path / "out", Options(model=weights, lookahead=2))
    bare = [replace(sanitise(frame), motion_next=None) for frame in frames]
    waiting = linked(tuple(bare[:2]))
    assert torch.equal(waiting[0].motion_next, completed(bare[0], bare[1]).motion_next)
    assert waiting[1].motion_next is None


@pytest.mark.parametrize("lookahead", [1, 2, 3])
def test_appended_frames_continue_a_finished_run(tmp_path, weights, lookahead):
    """As if all had been there at once: the last ones are denoised again, as there are frames after them now."""
    frames, options = make_frames(7), Options(model=weights, lookahead=lookahead, float32=True)
    denoise(str(write_sequence(tmp_path / "whole", frames)), tmp_path / "once", options)
    shot, before = tmp_path / "shot", 0
    for count in (1, 2, 5, 7):
        write_sequence(shot, frames[before:count])
        summary = denoise(str(shot), tmp_path / "out", options)
        again = denoise(str(shot), tmp_path / "out", options)  # nothing is left to do
        assert (again.written, again.skipped) == (0, count) and again.exposure == summary.exposure
        assert summary.skipped == max(0, before - lookahead) and summary.written == count - summary.skipped
        before = count
    for path in (tmp_path / "once").glob("*.exr"):
        assert path.read_bytes() == (tmp_path / "out" / path.name).read_bytes(), path.name


def test_what_a_finished_run_is_told_of(tmp_path, weights):
    frames, options = make_frames(5), Options(model=weights, lookahead=2)
    shot, out = write_sequence(tmp_path / "shot", frames), tmp_path / "out"
    denoise(str(shot), out, options)
    (out / "frame.0004.exr").unlink()  # one of the last
    assert denoise(str(shot), out, options).written == 2 and (out / "frame.0004.exr").exists()
    for other in (replace(options, float32=True), replace(options, lookahead=1)):
        with pytest.raises(InputError, match="other options"):
            denoise(str(shot), out, other)
    (shot / "frame.0004.exr").unlink()  # fewer than were denoised
    with pytest.raises(InputError, match="another input, layout or weights"):
        denoise(str(shot), out, options)
    short = write_sequence(tmp_path / "short", frames[:2])
    denoise(str(short), tmp_path / "short-out", options)
    with pytest.raises(InputError, match="other options"):
        denoise(str(short), tmp_path / "short-out", replace(options, float32=True))


def test_where_nothing_is_named_six_frames_are_ahead(tmp_path):
    shot = write_sequence(tmp_path / "shot", make_frames(8))
    denoise(str(shot), tmp_path / "auto", Options(float32=True))
    denoise(str(shot), tmp_path / "named", Options(model="hybrid", lookahead=6, float32=True))
    for path in (tmp_path / "auto").glob("*.exr"):
        assert path.read_bytes() == (tmp_path / "named" / path.name).read_bytes(), path.name


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"lookahead": -1}, "--lookahead: expected 0 to 16 frames, got -1"),
        ({"lookahead": 17}, "--lookahead: expected 0 to 16 frames, got 17"),
        ({"lookahead": 1.5}, "--lookahead: expected 0 to 16 frames, got 1.5"),
        ({"lookahead": True}, "--lookahead: expected 0 to 16 frames, got True"),
        ({"lookahead": 1, "offline": True}, "--lookahead: goes without --offline"),
        ({"lookahead": 1, "model": "paper"}, "^lookahead: model 'paper' does not average light"),
        ({"lookahead": 1, "backend": "glsl"}, "lookahead runs in PyTorch alone"),
    ],
)
def test_what_it_does_not_go_with(tmp_path, options, reason):
    shot = write_sequence(tmp_path / "shot", make_frames(2))
    with pytest.raises(InputError, match=reason):
        denoise(str(shot), tmp_path / "out", Options(**{"model": "default"} | options))


def test_methods_that_cannot_look_ahead():
    for name in ("oidn-ahead1", "paper-ahead1", "default-ahead17", "offline-ahead2"):
        with pytest.raises(InputError):
            choose([name])
    assert choose(["many-ahead3"])[0].delay == 3
