"""Samples that are lost in water and glass (`data.lost`)."""

from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from test_virtual_motion import SHOT

from rtdenoise.data import lost
from rtdenoise.data.lost import CHUNK, with_lost_samples
from rtdenoise.data.opening import open_sequence
from rtdenoise.frame import Frame
from rtdenoise.run.choice import open_chosen
from rtdenoise.run.options import Options

SIZE = 32, 48


def picture(lost=(), size=SIZE):
    """A wall of albedo 0.6, and one of 0.2 behind its right half; black where samples are `lost` (row, column)."""
    right = np.indices(size)[1] >= size[1] // 2
    albedo = np.where(right, 0.2, 0.6)[None, None].repeat(3, 1).astype(np.float32)
    for row, column in lost:
        albedo[..., row, column] = 0
    depth = np.where(right, 5, 3)[None, None].astype(np.float32)
    return Frame(albedo, albedo=albedo, depth=depth)


def test_a_lost_sample_gets_the_mean_of_the_surface():
    frame = picture([(10, 10), (20, 23)])
    found = with_lost_samples(frame).albedo[0, 0]
    assert np.allclose(found[[10, 20], [10, 23]], 0.6), "on its side of the edge alone, without lost ones"
    rest = np.ones(SIZE, bool)
    rest[[10, 20], [10, 23]] = False
    assert np.array_equal(found[rest], frame.albedo[0, 0][rest])


def test_beside_lost_samples_textures_stay_and_chance_does_not():
    draw, (rows, columns) = np.random.default_rng(2), np.indices(SIZE)
    frame, seen = picture(), draw.random(SIZE) < 0.5
    texture = (0.5 + 0.1 * np.sin(rows) * np.cos(columns)).astype(np.float32)
    frame.albedo[:] = np.where(columns < 16, texture, np.where(seen, 0.9, 0.1))  # to the right what is seen is chance
    lost = draw.random(SIZE) < 0.1
    frame.albedo[..., lost] = 0
    found = with_lost_samples(frame).albedo[0, 0]
    assert np.array_equal(found[:, :14][~lost[:, :14]], texture[:, :14][~lost[:, :14]])
    assert np.abs(found - texture)[:, :14].max() < 0.15 and found.min() > 0
    beside = ~lost & (np.pad(lost, 1)[:, 1:-1][:-2] | np.pad(lost, 1)[:, 1:-1][2:])
    assert found[:, 18:][beside[:, 18:]].std() < 0.15, "of 0.4"


def test_samples_that_are_lost_in_groups():
    lost = np.random.default_rng(3).random(SIZE) < 0.15
    found = with_lost_samples(picture(np.argwhere(lost))).albedo[0, 0]
    assert np.allclose(found, picture().albedo[0, 0]), "every sixth sample is lost, most beside others"


def test_letters_of_black_stay():
    """Groups of a few pixels, none of which is one pixel: they are no chance."""
    strokes = [(row + step, column) for row in (4, 14, 24) for column in range(3, 46, 6) for step in range(5)]
    frame = picture(strokes)
    assert np.array_equal(with_lost_samples(frame).albedo, frame.albedo)


def test_black_surfaces_and_what_was_hit_nowhere_stay():
    line = picture([(15, column) for column in range(4, 20)])
    found = with_lost_samples(line).albedo
    assert np.array_equal(found[..., 6:18], line.albedo[..., 6:18]), "a line of one pixel is no lost sample"
    area = picture([(row, column) for row in range(4, 9) for column in range(4, 9)])
    assert np.array_equal(with_lost_samples(area).albedo, area.albedo)
    sky = picture([(10, 10)])
    sky.depth[..., 10, 10] = 0
    assert np.array_equal(with_lost_samples(sky).albedo, sky.albedo)


def test_a_frame_without_any_is_itself():
    frame = picture()
    assert with_lost_samples(frame) is frame
    for layer in ("albedo", "depth"):
        lacks = replace(picture([(5, 5)]), **{layer: None})
        assert with_lost_samples(lacks) is lacks


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (300, 400)])
def test_any_size_and_broken_values(size):
    frame = picture([(0, 0)], size)
    draw = np.random.default_rng(0)
    frame.albedo[:, :, draw.random(size) < 0.1] = 0
    frame.depth[..., -1, -1], frame.albedo[..., -1, 0] = np.nan, np.nan
    found = with_lost_samples(frame).albedo
    assert found.shape == frame.albedo.shape and found.dtype == np.float32
    if np.prod(size) > CHUNK:
        assert np.isfinite(found).mean() > 0.999 and (found == 0).mean() < 0.3 * (frame.albedo == 0).mean()


def test_denoisers_take_a_network_for_water_where_many_are_lost(tmp_path):
    for file in sorted(SHOT.glob("*.exr"))[:2]:
        write_with_lost(file, tmp_path / file.name)
    sequence, options, (told,) = open_chosen(str(tmp_path), Options())
    assert (options.model, options.lookahead, sequence.lost_samples) == ("hybrid-large", 6, True)
    assert told.startswith("model: hybrid-large, because 1.0% of the samples are lost, as in water and glass;"), told
    assert open_chosen(str(tmp_path), Options(offline=True))[1].model == "hybrid-large"
    for other in ({"lookahead": 0}, {"offline": True, "signal": "indirect"}, {"signal": "indirect"}):
        assert open_chosen(str(tmp_path), Options(**other))[1].model == "hybrid"
    assert open_chosen(str(tmp_path), Options(samples=16))[1].model == "hybrid-large-many", "they are real then"
    assert open_chosen(str(tmp_path), Options(model="fast"))[1:] == (Options(model="fast", lookahead=0), [])
    assert open_chosen(str(SHOT), Options())[1].model == "hybrid"


def write_with_lost(file, copy):
    """A frame of Cycles with albedo 0 in one pixel of a hundred, none beside another."""
    opened = OpenEXR.File(str(file), separate_channels=True)
    for part in opened.parts:
        for name, channel in part.channels.items():
            if "Albedo" in name or "Diffuse Color" in name:
                channel.pixels[5::10, 5::10] = 0
    opened.write(str(copy))


def test_denoisers_read_frames_so():
    plain, chosen = open_sequence(SHOT), open_chosen(str(SHOT), Options(model="fast"))[0]
    assert chosen.lost_samples and not plain.lost_samples
    assert not open_chosen(str(SHOT), Options(model="fast", signal="indirect"))[0].lost_samples
    assert not open_chosen(str(SHOT), Options(model="fast", samples=16))[0].lost_samples, "they are real then"
    sequence = replace(plain, lost_samples=True)
    assert np.array_equal(sequence.read(0).albedo, with_lost_samples(plain.read(0)).albedo)
    assert sequence.only({"radiance", "depth"}).read(0).albedo is None
    assert np.array_equal(sequence.only({"radiance", "albedo"}).read(0).albedo, sequence.read(0).albedo)


@pytest.mark.parametrize("broken", [False, True])
def test_few_and_many_pixels_have_the_same_means(broken):
    draw = np.random.default_rng(1)
    albedo, depth = draw.random((3, 13, 17), np.float32), draw.choice(np.float32([0, 1, 1.05, 4]), (13, 17))
    if broken:
        albedo[0, 3, 4], albedo[:, 0, 0], depth[5, 6] = np.nan, np.inf, np.nan
    with np.errstate(invalid="ignore"):
        one, other = lost._at_places(albedo, depth, np.ones((13, 17), bool)), lost._everywhere(albedo, depth)
    np.testing.assert_allclose(one, other, rtol=1e-12)
    assert np.isnan(one).any() == broken
