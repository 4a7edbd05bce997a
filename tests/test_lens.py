"""Zooms and shifts of the picture that motion vectors lack (`run.lens`)."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import assert_goes_on, save_tiny, write_sequence
from test_combine import estimate, write_images
from test_denoise import pixels, refused
from test_virtual_motion import cycles

from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.frame import OFF_SCREEN, Frame
from rtdenoise.run.combine import combine
from rtdenoise.run.denoise import Options, denoise
from rtdenoise.run.inspect import inspect
from rtdenoise.run.inspect_text import next_step, render_text
from rtdenoise.run.lens import find_drift
from rtdenoise.run.lens_motion import FOUND, lacks_lens, with_lens
from rtdenoise.run.options import CombineOptions

SIZE = 72, 108
OPTIONS = Options(model="fast", precision="fp32")


def texture(x, y):
    """Waves of many lengths and directions, in [0, 1]."""
    waves = (0.21, 0.13, 0), (-0.3, 0.4, 1), (0.05, 0.5, 2), (0.6, 0.1, 3)
    return 0.5 + sum(torch.sin(x * a + y * b + c) for a, b, c in waves) / 8


def shot(count, zoom=0.0, shift=(0.0, 0.0), pan=(0.0, 0.0), noise=0.0, size=SIZE):
    """A wall before a camera that pans, whose vectors know the pan alone. A square before it stands still."""
    g, (H, W) = torch.Generator().manual_seed(0), size
    y, x = torch.meshgrid(torch.arange(H).float(), torch.arange(W).float(), indexing="ij")
    frames = []
    for number in range(count):
        lens = (1 + zoom) ** number
        u = ((x - (W - 1) / 2) - number * (shift[0] + pan[0])) / lens
        v = ((y - (H - 1) / 2) - number * (shift[1] + pan[1])) / lens
        albedo = texture(u, v) + noise * torch.randn(H, W, generator=g)
        square = (x > 50) & (x < 62) & (y > 30) & (y < 40)
        albedo = torch.where(square, 0.9, albedo).clamp(0, 1).expand(1, 3, H, W).contiguous()
        motion = torch.where(square, 0.0, -torch.tensor(pan).view(1, 2, 1, 1) + 1e-5)
        frames.append(Frame(
            albedo, albedo=albedo, normal=torch.tensor([0, 0, 1.0]).view(1, 3, 1, 1).repeat(1, 1, H, W),
            depth=torch.full((1, 1, H, W), 4.0), motion=motion, motion_next=-motion, number=number,
        ))  # fmt: skip
    return frames


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("pan", [(0.0, 0.0), (1.5, -0.6)])
@pytest.mark.parametrize(
    ("zoom", "shift"), [(0.03, (0.0, 0.0)), (-0.02, (0.0, 0.0)), (0.0, (3.0, -1.0)), (0.04, (-2.0, 0.5))]
)
def test_zoom_and_shift_are_measured(zoom, shift, pan, noise):
    drift = find_drift(*shot(2, zoom, shift, pan, noise))
    assert math.isclose(drift.zoom, zoom, abs_tol=2e-3)
    assert math.hypot(drift.shift[0] - shift[0], drift.shift[1] - shift[1]) < 0.15


@pytest.mark.parametrize("pan", [(0.0, 0.0), (4.0, 1.0)])
def test_vectors_that_are_right_lack_nothing(pan):
    assert find_drift(*shot(2, pan=pan, noise=0.05)) is None


def test_a_film_on_a_screen_is_no_zoom():
    """It moves alone, bright before a wall that stands still, and says most of what differs."""
    room, film = shot(2, noise=0.02), shot(2, shift=(2.0, -1.0))
    frames = []
    for wall, other in zip(room, film, strict=True):
        albedo = 0.3 * wall.albedo
        albedo[..., 4:68, 40:104] = other.albedo[..., 4:68, 40:104]
        frames.append(replace(wall, albedo=albedo))
    assert find_drift(*frames) is None


def test_a_frame_in_which_much_was_uncovered_needs_a_shot_that_zooms():
    first, second = shot(2, zoom=0.04)
    uncovered = torch.arange(SIZE[1]) < 0.55 * SIZE[1]
    second = replace(second, albedo=torch.where(uncovered, texture(torch.arange(SIZE[1]) * 1.7, 40.0), second.albedo))
    assert find_drift(first, second) is None
    assert math.isclose(find_drift(first, second, known=True).zoom, 0.04, abs_tol=4e-3)
    still = shot(2, noise=0.05)
    assert find_drift(*still, known=True) is None


def test_a_large_picture_says_what_moves():
    """There little zoom is much motion."""
    drift = find_drift(*shot(2, zoom=4e-4, size=(90, 3200)))
    assert math.isclose(drift.zoom, 4e-4, rel_tol=0.1) and drift.shift == (0.0, 0.0)
    assert "the picture zooms by +0.04% a frame against" in str(drift)


def test_a_strip_of_few_rows_is_examined():
    drift = find_drift(*shot(2, shift=(2.0, 0.0), size=(6, 400)))
    assert abs(drift.shift[0] - 2.0) < 0.15


def test_without_texture_nothing_is_told():
    flat = [replace(frame, albedo=torch.full_like(frame.albedo, 0.5)) for frame in shot(2, zoom=0.05)]
    assert find_drift(*flat) is None
    assert find_drift(*(replace(frame, albedo=None) for frame in flat)) is None


def test_noise_and_unknown_motion_are_no_lens():
    first, second = shot(2)
    other = torch.rand(2, *first.albedo.shape, generator=torch.Generator().manual_seed(1))
    assert find_drift(replace(first, albedo=other[0]), replace(second, albedo=other[1])) is None
    unknown = replace(second, motion=torch.full_like(second.motion, OFF_SCREEN))
    assert find_drift(first, unknown) is None


def test_inspect_and_denoise_tell(tmp_path):
    source = write_sequence(tmp_path / "zoom", shot(4, zoom=0.03))
    found = inspect(source)
    text = render_text(found)
    assert "lens         the picture zooms by +3.0% a frame against its motion vectors" in text
    assert "(in 3 of the pairs of frames examined)" in text and next_step(found).endswith("--lens")
    notes = denoise(str(source), tmp_path / "out", OPTIONS).notes
    assert sum("zooms by +3.0% a frame against its motion vectors" in note for note in notes) == 1
    source = write_sequence(tmp_path / "pan", shot(4, pan=(2.0, 0.0)))
    assert "lens" not in render_text(inspect(source))
    assert not any("lens" in note for note in denoise(str(source), tmp_path / "pan out", OPTIONS).notes)


def test_a_zoom_of_a_camera_that_stands_still_is_no_motion_blur(tmp_path):
    """Its vectors are zero everywhere, though the picture changes."""
    frames = [replace(f, motion=0 * f.motion, motion_next=0 * f.motion) for f in shot(4, zoom=0.03)]
    source = write_sequence(tmp_path / "zoom", frames)
    found = inspect(source)
    assert next_step(found).endswith("--lens") and "motion blur" not in render_text(found)
    notes = denoise(str(source), tmp_path / "out", OPTIONS).notes
    assert sum("zooms by +3.0%" in note for note in notes) == 1 and not any("motion blur" in note for note in notes)


def test_what_moves_after_a_still_beginning_is_judged(tmp_path):
    still, *moving = shot(4, zoom=0.04, pan=(0.3, 0.0))
    held = [replace(still, motion=0 * still.motion, motion_next=0 * still.motion, number=i) for i in range(4)]
    frames = [*held, *(replace(frame, number=3 + frame.number) for frame in moving)]
    notes = denoise(str(write_sequence(tmp_path / "shot", frames)), tmp_path / "out", OPTIONS).notes
    assert sum("the picture zooms by +4.0% a frame" in note for note in notes) == 1


@pytest.mark.parametrize(
    ("zoom", "shift"), [(0.03, (0.0, 0.0)), (-0.02, (0.0, 0.0)), (0.0, (3.0, -1.0)), (0.04, (-2.0, 0.5))]
)
def test_motion_with_the_lens_is_where_surfaces_were(tmp_path, zoom, shift):
    pan, (H, W) = (1.5, -0.6), SIZE
    source = open_sequence(write_sequence(tmp_path / "shot", shot(3, zoom, shift, pan, 0.03)))
    frame = with_lens(source)[2]
    y, x = torch.meshgrid(torch.arange(H) - (H - 1) / 2, torch.arange(W) - (W - 1) / 2, indexing="ij")
    moved = [shift[i] + pan[i] for i in (0, 1)]
    there = torch.stack([(p - 2 * m) / (1 + zoom) + m for p, m in zip((x, y), moved, strict=True)])  # in frame 1
    error = (frame.motion[0] - (there - torch.stack([x, y]))).norm(dim=0)
    error[31:40, 51:62] = 0  # the square
    assert error.max() < 0.25
    assert frame.motion_next is None and not with_lens(source).has("motion_next")


def test_unknown_motion_stays_unknown_and_right_motion_as_it_is(tmp_path):
    frames = shot(3, zoom=0.05)
    frames[2].motion[..., :20] = OFF_SCREEN
    source = with_lens(open_sequence(write_sequence(tmp_path / "zoom", frames)))
    assert source[2].motion[..., :20].abs().amax(1).min() > OFF_SCREEN / 2
    plain = open_sequence(write_sequence(tmp_path / "pan", shot(3, pan=(2.0, 0.0))))
    assert all(torch.equal(plain[i].motion, with_lens(plain)[i].motion) for i in range(3))


def test_after_a_gap_no_lens_is_known(tmp_path):
    frames = shot(5, zoom=0.03)
    folder = write_sequence(tmp_path / "shot", [*frames[:2], *frames[3:]])
    source = open_sequence(folder, allow_gaps=True)
    drifts = with_lens(source).drifts
    assert [drifts.of(i) is not None for i in range(4)] == [False, True, False, True]
    assert drifts.told == "--lens: added what the vectors of 2 of 4 frames lack"


def test_a_frame_between_others_for_which_nothing_is_found_is_named(tmp_path):
    frames = shot(6, zoom=0.03)
    frames[3] = replace(frames[3], albedo=torch.full_like(frames[3].albedo, 0.5))
    drifts = with_lens(open_sequence(write_sequence(tmp_path / "shot", frames))).drifts
    assert [drifts.of(i) is not None for i in range(6)] == [False, True, True, False, False, True]
    told = "--lens: added what the vectors of 3 of 6 frames lack, but found nothing for 3, 4 between them"
    assert drifts.told == told


def test_a_run_that_goes_on_tells_the_lens_of_the_frames_it_has_read(tmp_path):
    drifts = with_lens(open_sequence(write_sequence(tmp_path / "shot", shot(4, zoom=0.03)))).drifts
    drifts.of(3)
    assert drifts.told == "--lens: added what the vectors of 1 of 1 frames that this run read lack"


def noisy(frames):
    """The same with light of one sample a pixel."""
    g = torch.Generator().manual_seed(5)
    return [replace(f, radiance=f.albedo * -torch.rand(f.radiance.shape, generator=g).log()) for f in frames]


@pytest.mark.parametrize("more", [{}, {"lookahead": 2}, {"offline": True}])
def test_denoise_with_the_lens_keeps_textures(tmp_path, more):
    frames = shot(5, zoom=0.04)
    source = write_sequence(tmp_path / "zoom", noisy(frames))

    def error(lens):
        out = tmp_path / f"out {lens}"
        notes = denoise(str(source), out, replace(OPTIONS, float32=True, lens=lens, **more)).notes
        assert any(note == "--lens: added what the vectors of 4 of 5 frames lack" for note in notes) == lens
        assert any("against its motion vectors" in note for note in notes) != lens
        image = torch.from_numpy(pixels(out / "frame.0002.exr"))
        return (image - frames[2].albedo[0]).square().mean()

    assert error(True) < 0.85 * error(False)


def test_a_run_with_the_lens_goes_on(tmp_path):
    source = write_sequence(tmp_path / "zoom", noisy(shot(5, zoom=0.04)))
    model = str(save_tiny(tmp_path))
    assert_goes_on(source, tmp_path, replace(OPTIONS, model=model, lens=True), 3)


def write_cycles(folder, frames):
    folder.mkdir()
    for frame in frames:
        cycles(folder / f"frame.{frame.number:04}.exr", frame.map(torch.Tensor.numpy), frame.depth.numpy())
    return folder


@pytest.mark.parametrize("more", [{}, {"model": "auto"}, {"offline": True}])
def test_frames_of_cycles_get_it_by_themselves(tmp_path, more):
    """A zoom that begins with the fifth frame."""
    frames = [replace(frame, number=i) for i, frame in enumerate([*shot(1) * 3, *noisy(shot(3, zoom=0.04))])]
    source, options = write_cycles(tmp_path / "zoom", frames), replace(OPTIONS, float32=True, **more)
    told = "--lens: added what the vectors of 2 of 6 frames lack"
    found = denoise(str(source), tmp_path / "found", options)
    assert FOUND in found.notes and told in found.notes
    named = denoise(str(source), tmp_path / "named", replace(options, lens=True)).notes
    assert FOUND not in named and told in named
    left = denoise(str(source), tmp_path / "left", replace(options, detect_lens=False)).notes
    assert FOUND not in left and told not in left
    found, named, left = (pixels(tmp_path / name / "frame.0005.exr") for name in ("found", "named", "left"))
    assert np.array_equal(found, named) and not np.array_equal(found, left)


def test_only_cycles_and_what_can_be_examined_is(tmp_path):
    frames = shot(6, zoom=0.04)
    assert lacks_lens(open_sequence(write_cycles(tmp_path / "cycles", frames)))
    assert not lacks_lens(open_sequence(write_cycles(tmp_path / "one", frames[:1])))
    assert not lacks_lens(open_sequence(write_cycles(tmp_path / "pan", shot(6, pan=(2.0, 0.0)))))
    assert not lacks_lens(open_sequence(tmp_path / "cycles").only({"radiance", "motion"}))
    assert not lacks_lens(open_sequence(write_sequence(tmp_path / "native", frames)))


def test_a_pair_beside_one_that_only_hints_at_it_is_asked(tmp_path):
    """What stands still before the wall, in the two frames that are compared first."""
    frames, film = shot(7, zoom=0.04), shot(1)[0].albedo
    for i in (3, 4):
        albedo = frames[i].albedo.clone()
        albedo[..., 6:66, 20:46] = film[..., 6:66, 20:46]
        frames[i] = replace(frames[i], albedo=albedo)
    assert find_drift(*frames[3:5]) is None and find_drift(*frames[3:5], known=True)
    assert lacks_lens(open_sequence(write_cycles(tmp_path / "zoom", frames)))


def test_a_frame_that_cannot_be_read_is_told_when_it_comes(tmp_path):
    source = write_cycles(tmp_path / "zoom", shot(6, pan=(2.0, 0.0)))
    broken = source / "frame.0004.exr"
    whole = broken.read_bytes()
    broken.write_bytes(whole[:-20_000] + bytes(10_000) + whole[-10_000:])
    with pytest.raises(InputError, match=broken.name.replace(".", "[.]")):
        denoise(str(source), tmp_path / "out", OPTIONS)
    assert len([*(tmp_path / "out").glob("*.exr")]) == 4


def test_a_run_that_found_it_goes_on(tmp_path):
    source = write_cycles(tmp_path / "zoom", noisy(shot(7, zoom=0.04)))
    assert_goes_on(source, tmp_path, replace(OPTIONS, model=str(save_tiny(tmp_path))), 3)


def test_combine_finds_it(tmp_path):
    frames = noisy(shot(5, zoom=0.04))
    source = write_cycles(tmp_path / "noisy", frames)
    write_images(tmp_path / "denoised", [estimate(frame) for frame in frames])
    for detect in (True, False):
        options = CombineOptions(samples=4, detect_lens=detect)
        notes = combine(str(source), str(tmp_path / "denoised"), tmp_path / f"out {detect}", options).notes
        assert (FOUND in notes) == detect


def test_combine_takes_the_lens(tmp_path):
    frames = noisy(shot(4, zoom=0.04))
    source = write_sequence(tmp_path / "noisy", frames)
    write_images(tmp_path / "denoised", [estimate(frame) for frame in frames])
    results = []
    for lens in (False, True):
        out = tmp_path / f"out {lens}"
        options = CombineOptions(samples=4, float32=True, lens=lens)
        notes = combine(str(source), str(tmp_path / "denoised"), out, options).notes
        assert ("--lens: added what the vectors of 3 of 4 frames lack" in notes) == lens
        results.append((pixels(out / "frame.0002.exr") - frames[2].albedo[0].numpy()).var())
    assert results[1] < results[0]


def test_without_albedo_or_motion_the_lens_is_refused(tmp_path, capsys):
    for layer in ("albedo", "motion"):
        source = write_sequence(tmp_path / layer, shot(2), without=(layer,))
        assert f"no layer '{layer}'" in refused(capsys, "denoise", source, "--out", tmp_path / "out", "--lens")
