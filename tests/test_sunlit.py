"""A sun on generated scenes: its direction, the openings it shines through, its light and its shadows."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from rendering import render_here

from rtdenoise.data.clip_file import read_facts
from rtdenoise.errors import InputError
from rtdenoise.render.frames import radiance
from rtdenoise.render.options import ClipOptions
from rtdenoise.render.scenes import meshes, textures, wide
from rtdenoise.render.scenes.motions import CameraPath
from rtdenoise.render.scenes.named import open_scene
from rtdenoise.render.scenes.scene import Material, Object, Scene, Sun
from rtdenoise.render.scenes.sunlit import BLACK, HALF, OPEN_TO, PANELS, sunlit
from rtdenoise.render.stage import Stage
from rtdenoise.render.streams import NOISY

SEEDS = range(40)
TINY = ClipOptions(count=4, size=(32, 32), frames=2, seed=5, reference_range=(4, 8), workers=1, sun=1.0)


plain = cache(wide.procedural)


@cache
def lit(seed: int) -> Scene:
    return sunlit(wide.procedural(seed), np.random.default_rng(seed))


def test_the_sun_shines_through_a_side_that_is_open():
    facing = []
    for scene in map(lit, SEEDS):
        towards, names = np.array(scene.sun.towards), {o.name for o in scene.objects}
        assert np.linalg.norm(towards) == pytest.approx(1) and towards[1] > 0
        if "floor" in names:
            facing.append(max(towards @ OPEN_TO[side] for side in OPEN_TO.keys() - names))
    assert len(facing) > 20 and np.mean(np.array(facing) > 0.3) > 0.8


def test_only_a_closed_room_loses_a_side():
    for seed in SEEDS:
        before, after = plain(seed), lit(seed)
        names = {o.name for o in before.objects}
        lost = names - {o.name for o in after.objects}
        closed = {"floor", *OPEN_TO} <= names
        assert len(lost) == closed and lost <= OPEN_TO.keys()


def test_lamps_reflect_nothing_and_ids_stay_unique():
    scenes = [lit(seed) for seed in SEEDS]
    for scene in scenes:
        assert len({o.id for o in scene.objects}) == len(scene.objects)
        assert all(o.material == BLACK for o in scene.objects if o.emission is not None)
    assert sum(o.name == "window" for scene in scenes for o in scene.objects) > 5


def test_what_the_sun_comes_through_is_outside_and_faces_it():
    kinds = set()
    for scene in map(lit, SEEDS):
        kind = scene.facts["sun_through"]
        kinds.add(kind)
        if kind == "none":
            continue
        panel, towards = scene.objects[-1].mesh, np.array(scene.sun.towards)
        across = panel.vertices - panel.vertices.mean(0)
        assert np.abs(across @ towards).max() < (0.8 if kind != "leaves" else 3 * HALF)
        corners = panel.vertices[panel.faces]
        area = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ towards).sum() / 4
        assert 0.1 < area / (2 * HALF) ** 2 < 1.2, kind  # shades a good part; of a grid's bars some lie on others
        room = [o.mesh.vertices for o in scene.objects if o.name in ("floor", "back", *OPEN_TO)]
        if room:
            low, high = np.concatenate(room).min(0), np.concatenate(room).max(0)
            assert ((panel.vertices < low) | (panel.vertices > high)).any(1).all(), kind
    assert kinds == set(PANELS)


def test_a_seed_is_a_scene():
    a, b, other = lit(3), lit.__wrapped__(3), lit(4)
    assert a.sun == b.sun != other.sun and a.facts == b.facts


def test_light_and_shadow_of_a_sun_are_exact():
    """Seen from above: a floor of known reflectance, half of it under a roof that is out of view."""
    grey = Material(textures.plain(0.4))
    floor = Object(1, "floor", meshes.quad((-5, 0, 5), (10, 0, 0), (0, 0, -10)), grey)
    roof = Object(2, "roof", meshes.quad((0, 3, 5), (10, 0, 0), (0, 0, -10)), Material(textures.plain(0.0)))
    towards = np.array([0.0, 0.8, 0.6])
    camera = CameraPath((0, 2, 0), (0, 0, 0.001), fov=50)
    scene = Scene("floor", (floor, roof), camera, sun=Sun(tuple(towards), (3.0, 2.0, 1.0)))
    beauty, indirect = radiance(Stage(scene), 0, (16, 16), 4, 0, NOISY, 6)
    expected = 0.4 / np.pi * 0.8 * np.array([3.0, 2.0, 1.0])
    bright = beauty.sum(-1) > 0.01
    assert 0.4 < bright.mean() < 0.6
    border = np.ptp(bright.mean(0)) if np.ptp(bright.mean(0)) > np.ptp(bright.mean(1)) else np.ptp(bright.mean(1))
    assert border == 1  # whole rows or columns are lit, others are not
    full = np.isclose(beauty, expected, rtol=1e-4).all(-1)
    assert full.mean() > 0.4 and not beauty[~bright].any()
    assert indirect.max() < 1e-6


def test_sunlit_is_a_scene_to_render_and_shows_something():
    scene = open_scene("sunlit:7")
    assert scene.sun is not None and scene.exposure != 1
    with pytest.raises(InputError, match="sunlit:SEED"):
        open_scene("sunlit:x")


def test_a_set_says_that_it_is_lit_and_is_not_mixed_up_with_others(tmp_path):
    card = render_here(tmp_path, TINY, lambda *_: None)
    assert read_facts(tmp_path / "clip_000000.safetensors")["sun_through"] in PANELS
    assert card["sunlit"] == 4 and "4 clips have a sun" in (tmp_path / "DATA.md").read_text()
    others = {"sun": 0.0, "reference_error": 0.5, "generator": 2, "scenes": (("hall/scene.xml", ""),)}
    for name, value in others.items():
        with pytest.raises(InputError, match="choose another --out or the options of that run"):
            render_here(tmp_path, replace(TINY, **{name: value}), lambda *_: None)


def test_nothing_moves_that_did_not():
    for seed in SEEDS:
        before, after = (
            {o.id: o.motion for o in scene.objects if o.motion} for scene in (plain(seed), lit(seed))
        )
        assert before == after
