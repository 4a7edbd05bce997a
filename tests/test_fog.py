"""Samples that are scattered in fog (`data.fog`)."""

from dataclasses import replace

import numpy as np
import pytest
from test_virtual_motion import SHOT

from rtdenoise.cli.main import main
from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.data.fog import REACH, with_fog
from rtdenoise.data.opening import open_sequence
from rtdenoise.frame import OFF_SCREEN, Frame
from rtdenoise.run.choice import open_chosen
from rtdenoise.run.options import Options

SIZE = 48, 64
WALL, FOG = 0.8, 0.3  # albedo


def foggy(share=0.5, seed=0, size=SIZE):
    """A wall, a box before its right half, and fog before both; the light of fog."""
    draw = np.random.default_rng(seed)
    scattered = draw.random((1, 1, *size)) < share
    right = np.broadcast_to(np.arange(size[1]) >= size[1] // 2, (1, 1, *size))
    depth = np.where(scattered, 0, np.where(right, 3, 6)).astype(np.float32)
    normal = np.zeros((1, 3, *size), np.float32)
    normal[:, 2] = ~scattered[:, 0]
    motion = np.where(scattered, OFF_SCREEN, np.where(right, 2, 1)).repeat(2, 1).astype(np.float32)
    albedo = np.where(scattered, FOG, WALL).repeat(3, 1).astype(np.float32)
    light = (scattered * draw.random((1, 1, *size))).repeat(3, 1).astype(np.float32)
    frame = Frame(albedo * 1, albedo=albedo, normal=normal, depth=depth, motion=motion, motion_next=-motion)
    return frame, light


def test_fog_gets_the_surface_behind():
    frame, light = foggy()
    found = with_fog(frame, light, np.zeros_like(light))
    left, right = (..., slice(0, 30)), (..., slice(34, None))
    assert (found.depth[left] == 6).all() and (found.depth[right] == 3).all()
    assert (found.motion[left] == 1).all() and (found.motion[right] == 2).all()
    assert (found.motion_next == -found.motion).all() and (found.normal[:, 2] == 1).all()
    hit = frame.depth > 0
    assert (found.depth[hit] == frame.depth[hit]).all(), "what was hit stays"
    assert np.array_equal(found.radiance, frame.radiance)


@pytest.mark.parametrize("share", [0.2, 0.65])
def test_albedo_is_that_of_both(share):
    frame, light = foggy(share)
    albedo = with_fog(frame, light, None).albedo
    assert albedo.mean() == pytest.approx((1 - share) * WALL + share * FOG, abs=0.02)
    assert albedo.std() < 0.3 * frame.albedo.std()
    assert np.array_equal(with_fog(frame, light, None, few_samples=False).albedo, frame.albedo)


def test_textures_stay_sharp_in_thin_fog():
    """What was hit keeps its own albedo in the mixture."""
    frame, light = foggy(0.2)
    boards = np.where(np.arange(SIZE[1]) % 2, 0.2, 0.8).astype(np.float32)
    hit = frame.depth > 0
    textured = np.where(hit, boards, FOG).astype(np.float32).repeat(3, 1)
    albedo = with_fog(replace(frame, albedo=textured), light, None).albedo
    step = albedo[..., 1::2] - albedo[..., 0::2]
    both = (hit[..., 1::2] & hit[..., 0::2]).repeat(3, 1)
    assert np.abs(step[both] + 0.8 * 0.6).max() < 0.15


def test_a_frame_without_fog_is_itself():
    frame, light = foggy()
    assert with_fog(frame, 0 * light, None) is frame
    clear = replace(frame, depth=frame.depth + 1)
    assert with_fog(clear, light, None) is clear
    assert with_fog(replace(frame, depth=None), light, None).depth is None


def test_the_sky_is_no_fog():
    """Neither its samples among those of fog, nor where there is no fog around."""
    frame, light = foggy(0.3)
    sky = np.zeros_like(light)
    sky[..., :20] = (frame.depth == 0)[..., :20]
    found = with_fog(frame, light * (sky == 0), sky)
    assert ((found.depth == 0) == (sky[:, :1] > 0)).all()
    far = np.zeros_like(light)
    far[..., :8, :8] = light[..., :8, :8]  # a puff in a corner
    found = with_fog(frame, far, None)
    away = (..., slice(34, None), slice(34, None))
    assert (found.depth[away] == 0).any() and np.array_equal(found.depth[away], frame.depth[away])


def test_what_is_far_from_all_surfaces_stays():
    frame, light = foggy(0.5)
    depth, motion = frame.depth.copy(), frame.motion.copy()
    depth[..., :24], motion[..., :24] = 0, OFF_SCREEN
    light[..., :24] = 1
    found = with_fog(replace(frame, depth=depth, motion=motion), light, np.zeros_like(light))
    assert (found.depth[..., : 24 - REACH - 1] == 0).all() and (found.depth[..., 24 - 3 :] > 0).all()
    assert np.isfinite(found.albedo).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (17, 5), (33, 40)])
def test_any_size_and_broken_values(size):
    frame, light = foggy(0.5, size=size)
    broken = frame.depth.copy()
    broken[..., 0, 0] = np.nan
    found = with_fog(replace(frame, depth=broken, albedo=None, motion_next=None), light, None)
    assert found.depth.shape == frame.depth.shape and found.albedo is None and found.motion_next is None
    with_fog(replace(frame, depth=np.full_like(broken, np.inf)), light * np.nan, None)


@pytest.fixture
def shot(tmp_path):
    """Two frames of Cycles, the left half of which is seen through fog."""
    folder = tmp_path / "shot"
    folder.mkdir()
    for path in sorted(SHOT.glob("*.exr"))[:2]:
        channels = read_channels(path, read_header(path).channels.keys())
        missed = np.random.default_rng(0).random(channels["ViewLayer.Depth.Z"].shape) < 0.4
        missed[:, missed.shape[1] // 2 :] = False
        for name, image in channels.items():
            fill = {"ViewLayer.Depth.Z": 1e10}.get(name, 0.0)
            if name.startswith(("ViewLayer.Depth", "ViewLayer.Normal", "ViewLayer.Vector")):
                channels[name] = np.where(missed, np.float32(fill), image)
        for c in "RGB":
            channels[f"ViewLayer.VolumeDir.{c}"] = missed.astype(np.float32)
        write_layers(folder / path.name, channels, dtypes=dict.fromkeys(channels, "float"))
    return folder


def test_frames_of_cycles_are_read_so(shot):
    plain, chosen = open_sequence(shot), open_chosen(str(shot), Options(model="fast", samples=1))[0]
    missed = plain.read(0).depth == 0
    assert chosen.fog and chosen.few_samples and missed.mean() > 0.1 and not (chosen.read(0).depth == 0).any()
    assert (chosen.only({"radiance", "motion"}).read(0).motion == chosen.read(0).motion).all()
    assert chosen.only({"radiance"}).read(0).depth is None
    left = open_chosen(str(shot), Options(model="fast", samples=1, fog=False))[0]
    assert np.array_equal(left.read(0).depth, plain.read(0).depth)
    many = open_chosen(str(shot), Options(model="fast", samples=16))[0]
    assert many.fog and np.array_equal(many.read(0).albedo, plain.read(0).albedo)
    assert not open_chosen(str(shot), Options(model="fast", signal="indirect"))[0].fog


def test_the_option_belongs_to_a_run(shot, tmp_path, capsys):
    run = ["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", "fast"]
    main(run)
    with pytest.raises(SystemExit):
        main([*run, "--no-fog"])
    assert "fog" in capsys.readouterr().err
