"""Panoramas, whose left and right edges meet (`data.panorama`)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.data.opening import open_sequence
from rtdenoise.data.panorama import Panorama, find_panorama
from rtdenoise.frame import OFF_SCREEN, Frame
from rtdenoise.run.combine import combine
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import CombineOptions, Options
from rtdenoise.run.panorama import JOINED

SHOT = sorted((Path(__file__).parent / "data" / "cycles").glob("*.exr"))
SEAM = np.s_[:3, :, [0, 1, -2, -1]]
SIDE = min(read_header(SHOT[0]).height, read_header(SHOT[0]).width) // 32 * 32


def around(depth, mirrored=False, tilt=0.3):
    """A frame of a depth `[H, W]`, and of normals that face a camera which looks around, tilted."""
    H, W = depth.shape
    rise, turn = np.pi * (0.5 - (np.arange(H)[:, None] + 0.5) / H), 2 * np.pi * (np.arange(W) + 0.5) / W
    x, y, z = np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise) + 0 * turn
    normal = -np.stack([x, np.cos(tilt) * y - np.sin(tilt) * z, np.sin(tilt) * y + np.cos(tilt) * z])
    normal = np.float32(normal[None] if not mirrored else normal[None, [1, 0, 2]])
    return Frame(np.zeros((1, 3, H, W), np.float32), normal=normal, depth=np.float32(depth)[None, None])


def write_panorama(folder, turned=0, count=2):
    """Frames of the shot beside their mirror images, whose edges meet, turned by so many columns."""
    folder.mkdir()
    normal = around(np.ones((SIDE, 2 * SIDE))).normal[0]
    for path in SHOT[:count]:
        planes = read_channels(path, list(read_header(path).channels))
        for name, plane in planes.items():
            half = plane[:SIDE, :SIDE]
            planes[name] = np.roll(np.concatenate([half, half[:, ::-1]], axis=1), turned, axis=1)
        planes |= {f"ViewLayer.Normal.{c}": np.roll(n, turned, axis=1) for c, n in zip("XYZ", normal, strict=True)}
        write_layers(folder / path.name, planes, dtypes=dict.fromkeys(planes, "float"))
    return folder


def denoised(folder, turned, options):
    """The last frame of a panorama `[4, H, W]` that was denoised so turned, and turned back."""
    shot, out = folder / f"shot-{turned}", folder / f"out-{turned}"
    summary = denoise(str(write_panorama(shot, turned)), out, options)
    assert (JOINED in summary.notes) == options.detect_panorama
    layer = "" if options.layout == "plain" else "ViewLayer.Combined."
    planes = read_channels(sorted(out.glob("*.exr"))[-1], [f"{layer}{c}" for c in "RGBA"])
    return np.roll(np.stack([*planes.values()]), -turned, axis=2)


@pytest.mark.parametrize("options", [
    Options(model="default"), Options(layout="source", lights=True, model="default"), Options(offline=True),
    Options(signal="indirect", recombine=True, model="default"), Options(motion_blur=True, model="default"),
    Options(layout="source", lights=True, offline=True, model="default"),
], ids=["plain", "lights", "offline", "recombine", "motion-blur", "offline-lights"])  # fmt: skip
def test_a_panorama_has_no_seam(tmp_path, options):
    # Turned by half its width a panorama has its edges in the middle.
    whole, turned = (denoised(tmp_path, turn, options) for turn in (0, SIDE))
    assert whole.shape == (4, SIDE, 2 * SIDE)
    difference = np.abs(whole - turned)
    assert difference[SEAM].mean() < 0.004 * whole[SEAM].mean()
    assert difference[3].max() < 0.02


@pytest.mark.parametrize("detect", [True, False])
def test_nor_has_a_corrected_one(tmp_path, detect):
    made = []
    for turned in (0, SIDE):
        noisy, flat, out = (tmp_path / f"{name}-{turned}" for name in ("noisy", "flat", "out"))
        write_panorama(noisy, turned, count=4)
        write_panorama(flat, turned, count=4)
        for path in flat.iterdir():  # the mean of each row is far from what is there, so that much is corrected
            light = read_channels(path, [f"ViewLayer.Combined.{c}" for c in "RGB"]).values()
            means = [np.broadcast_to(plane.mean(1, keepdims=True), plane.shape) for plane in light]
            write_layers(path, dict(zip("RGB", means, strict=True)), dtypes=dict.fromkeys("RGB", "float"))
        summary = combine(str(noisy), str(flat), out, CombineOptions(samples=4, detect_panorama=detect))
        assert (JOINED in summary.notes) == detect
        planes = read_channels(sorted(out.glob("*.exr"))[1], [*"RGB"])
        made.append(np.roll(np.stack([*planes.values()]), -turned, axis=2))
    difference = np.abs(made[0] - made[1])[SEAM].mean()
    assert difference < 1e-4 if detect else difference > 1e-3


def test_it_has_one_where_none_is_looked_for(tmp_path):
    options = Options(model="default", detect_panorama=False)
    whole, turned = (denoised(tmp_path, turn, options) for turn in (0, SIDE))
    assert np.abs(whole - turned)[SEAM].mean() > 0.03 * whole[SEAM].mean()


def test_frames_are_read_with_columns_of_the_other_side(tmp_path):
    sequence = open_sequence(write_panorama(tmp_path / "shot", count=1))
    whole, panorama = sequence.read(0), Panorama(2 * SIDE)
    sequence = replace(sequence, beyond=panorama)
    assert sequence.read_size == (SIDE, 2 * SIDE + 2 * panorama.beside)
    for layer, image in sequence.read(0).layers():
        assert image.shape[2:] == sequence.read_size
        if "motion" not in layer:
            assert np.array_equal(panorama.within(image), getattr(whole, layer))
            assert np.array_equal(image[..., : panorama.beside], getattr(whole, layer)[..., -panorama.beside :])
            assert np.array_equal(image[..., -panorama.beside :], getattr(whole, layer)[..., : panorama.beside])


def test_motion_in_parts_of_the_picture_is_that_of_the_picture_itself(tmp_path):
    layers = {"color": np.ones((64, 128, 3), np.float32), "flow": np.full((64, 128, 2), 0.125, np.float32)}
    write_layers(tmp_path / "frame.0001.exr", layers, dtypes={"flow": "float"})
    preset = tmp_path / "my.toml"
    preset.write_text('[color]\nchannels = ["R", "G", "B"]\n[motion]\nchannels = ["flow.X", "flow.Y"]\nscale = "uv"\n')
    joined = replace(open_sequence(tmp_path, preset=str(preset)), beyond=Panorama(128)).read(0).motion
    assert joined.shape == (1, 2, 64, 256) and (joined[0, 0] == 16).all() and (joined[0, 1] == 8).all()


def test_motion_takes_the_shorter_way_round():
    motion = np.zeros((1, 2, 1, 6), np.float32)
    motion[0, 0, 0] = 3, 199, -198.5, 100, OFF_SCREEN, np.nan
    frame = Panorama(200).joined(Frame(np.zeros((1, 3, 1, 6), np.float32), motion=motion, motion_next=motion))
    expected = motion.copy()
    expected[0, 0, 0, 1:3] = -1, 1.5
    for found in (frame.motion, frame.motion_next):
        assert np.array_equal(found, expected, equal_nan=True) and found.dtype == np.float32
    assert Panorama(200).joined(replace(frame, motion=None, motion_next=None)).motion is None


@pytest.mark.parametrize(("width", "beside"), [(32, 16), (100, 48), (512, 64), (1024, 64), (4096, 256)])
def test_so_many_columns_lie_beside(width, beside):
    assert Panorama(width).beside == beside
    assert Panorama(width).around(np.zeros((2, width))).shape == (2, width + 2 * beside)


def test_a_panorama_is_found_by_its_edges_and_by_what_faces_it():
    rows, turn = np.mgrid[:64, :128]
    room = 3 + np.cos(turn * np.pi / 64) + rows / 64
    assert find_panorama(around(room)) == find_panorama(around(room, mirrored=True)) == Panorama(128)
    assert find_panorama(around(np.where(rows < 32, 0, room))) == Panorama(128)  # under a sky
    assert find_panorama(around(np.where(rows < 60, 0, room))) is None  # sky tells nothing
    assert find_panorama(around(room[:, :64])) is None
    assert find_panorama(around(np.repeat(room, 2, 0))) is None
    assert find_panorama(around(3 + turn / 64)) is None
    assert find_panorama(around(np.full_like(room, np.nan))) is None
    assert find_panorama(replace(around(room), depth=None)) is None
    other = around(room)
    other.normal[..., -1] = np.float32([1, 0, 0]).reshape(1, 3, 1)
    assert find_panorama(other) is None


def test_a_wall_twice_as_wide_as_high_is_no_panorama():
    wall = around(np.full((64, 128), 5.0))
    wall.normal[:] = np.float32([0, 0.6, 0.8]).reshape(1, 3, 1, 1)
    assert find_panorama(wall) is None
    wall.normal[:] = np.nan
    assert find_panorama(wall) is None
