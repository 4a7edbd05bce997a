"""Samples of what is less than half opaque (`data.veiled`)."""

from dataclasses import replace

import numpy as np
import pytest
from test_virtual_motion import SHOT

from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.data.fog import REACH
from rtdenoise.data.opening import open_sequence
from rtdenoise.data.veiled import with_veiled
from rtdenoise.frame import Frame
from rtdenoise.run.choice import open_chosen
from rtdenoise.run.options import Options

SIZE = 48, 64
LAYERS = "depth", "normal", "motion", "motion_next"


def veiled(share=0.4, size=SIZE):
    """A wall, a box before its right half, and a veil before both; where samples show the veil."""
    cloth = np.random.default_rng(0).random((1, 1, *size)) < share
    right = np.broadcast_to(np.arange(size[1]) >= size[1] // 2, (1, 1, *size))
    depth = np.where(cloth, 1, np.where(right, 3, 6)).astype(np.float32)
    normal = np.zeros((1, 3, *size), np.float32)
    normal[:, 2] = ~cloth[:, 0]
    motion = np.where(cloth, 0, np.where(right, 2, 1)).repeat(2, 1).astype(np.float32)
    light = np.ones((1, 3, *size), np.float32)
    return Frame(light, albedo=light, normal=normal, depth=depth, motion=motion, motion_next=-motion), cloth[0, 0]


def test_a_veil_gets_the_surface_behind():
    frame, cloth = veiled()
    found = with_veiled(frame)
    left, right = (..., slice(0, 30)), (..., slice(34, None))
    assert (found.depth[left] == 6).all() and (found.depth[right] == 3).all()
    assert (found.motion[left] == 1).all() and (found.motion[right] == 2).all()
    assert (found.motion_next == -found.motion).all() and (found.normal[:, 2] == 1).all()
    for name in LAYERS:
        assert np.array_equal(getattr(found, name)[..., ~cloth], getattr(frame, name)[..., ~cloth]), "others stay"
    assert found.radiance is frame.radiance


def test_a_pane_has_the_mean_of_its_albedo():
    """A few samples that it has turned back are dark dots otherwise."""
    frame, cloth = veiled()
    frame = replace(frame, albedo=np.where(cloth, np.float32(0.05), np.float32(0.6)) * frame.albedo)
    found, apart = with_veiled(frame).albedo, [slice(2, -2), slice(4, 28)]  # a surface alone within reach
    dots = cloth[*apart]
    assert found[0, :, *apart][:, dots].std() < 0.12 and found[0, :, *apart][:, dots].min() > 0.15
    assert found[0, :, *apart][:, dots].mean() == pytest.approx(0.6 * 0.6 + 0.4 * 0.05, abs=0.03)
    assert np.array_equal(found[..., ~cloth], frame.albedo[..., ~cloth]), "others stay"
    bare = replace(frame, albedo=None)
    assert with_veiled(bare).albedo is None and (with_veiled(bare).normal[:, 2] == 1).all()


def test_a_frame_without_any_is_itself():
    frame = veiled(0)[0]
    assert with_veiled(frame) is frame
    frame = veiled()[0]
    for lacks in ({"depth": None}, {"normal": None}, {"motion": None, "motion_next": None}):
        given = replace(frame, **lacks)
        assert with_veiled(given) is given
    everywhere = veiled(1)[0]
    assert with_veiled(everywhere) is everywhere, "there is no other surface"


def test_what_was_not_hit_or_has_a_normal_or_moves_stays():
    frame, cloth = veiled()
    for name, value in (("depth", 0), ("normal", 1), ("motion", 1), ("motion_next", 1)):
        layer = getattr(frame, name).copy()
        layer[..., cloth] = value
        given = replace(frame, **{name: layer})
        assert with_veiled(given) is given, name


def test_what_is_far_from_all_surfaces_stays():
    frame, _ = veiled(0)
    for name in LAYERS:
        getattr(frame, name)[..., 8:] = 1 if name == "depth" else 0
    found = with_veiled(frame)
    assert (found.motion[..., 8 : 8 + REACH] == 1).all() and (found.motion[..., 8 + REACH :] == 0).all()
    assert (found.depth[..., 8 + REACH :] == 1).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 3)])
def test_any_size_and_broken_values(size):
    frame, _ = veiled(0.5, size)
    frame.depth[..., -1, -1], frame.normal[..., 0, 0], frame.motion[..., -1, 0] = np.nan, np.nan, np.inf
    found = with_veiled(frame)
    assert all(getattr(found, name).shape == getattr(frame, name).shape for name in LAYERS)


@pytest.fixture
def shot(tmp_path):
    """Frames of Cycles in which two samples in five of the left half show a veil at distance 1."""
    for path in sorted(SHOT.glob("*.exr"))[:2]:
        channels = read_channels(path, read_header(path).channels.keys())
        cloth = np.random.default_rng(0).random(channels["ViewLayer.Depth.Z"].shape) < 0.4
        cloth[:, cloth.shape[1] // 2 :] = False
        for name, image in channels.items():
            if name.startswith(("ViewLayer.Depth", "ViewLayer.Normal", "ViewLayer.Vector")):
                channels[name] = np.where(cloth, np.float32(name == "ViewLayer.Depth.Z"), image)
        write_layers(tmp_path / path.name, channels, dtypes=dict.fromkeys(channels, "float"))
    return tmp_path


def test_frames_of_cycles_are_read_so(shot):
    plain, chosen = open_sequence(shot), open_chosen(str(shot), Options(model="fast", samples=1))[0]
    lacks = (plain.read(0).normal == 0).all(1)
    assert chosen.veiled and not plain.veiled and lacks.mean() > 0.1
    found = chosen.read(0)
    assert not (found.normal == 0).all(1).any() and not (found.depth == 1).any()
    assert (chosen.only({"radiance", "motion"}).read(0).motion == found.motion).all()
    assert (chosen.only({"radiance", "depth"}).read(0).depth == found.depth).all()
    assert chosen.only({"radiance"}).read(0).depth is None
    assert open_chosen(str(shot), Options(model="fast", signal="indirect"))[0].veiled
    assert not open_chosen(str(shot), Options(model="fast", samples=16))[0].veiled, "they are means then"
