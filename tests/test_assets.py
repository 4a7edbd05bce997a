"""Libraries of assets: their index, compositions of them, several takes of one scene, and holes in surfaces."""

import itertools
import json
import os
import re
import struct
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from rendering import render_here
from safetensors.numpy import save_file

from rtdenoise.cli.main import main
from rtdenoise.data.clip_file import clip_path, read_facts, read_layers
from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.exr import write_layers
from rtdenoise.errors import InputError
from rtdenoise.render.clips import refuse_other_options
from rtdenoise.render.draw import VIEWS, draw_takes
from rtdenoise.render.frames import features, radiance
from rtdenoise.render.options import ClipOptions
from rtdenoise.render.scene_clips import draw_samples
from rtdenoise.render.scenes import meshes, placing
from rtdenoise.render.scenes.assets import load_hdri, load_model, read_library, read_picture, require_models
from rtdenoise.render.scenes.composed import KINDS, Composer, compose
from rtdenoise.render.scenes.extras import shapes_in_view
from rtdenoise.render.scenes.file import open_file
from rtdenoise.render.scenes.motions import CameraPath, Motion
from rtdenoise.render.scenes.placing import LONGEST, metres, plain
from rtdenoise.render.scenes.scene import Object, Scene, Sun
from rtdenoise.render.scenes.takes import compose_take, film_take
from rtdenoise.render.stage import Stage
from rtdenoise.render.streams import NOISY

CATEGORIES = {  # category -> width, height, depth in metres
    "furniture": (1.2, 0.75, 0.7), "plant": (0.4, 0.9, 0.4), "people": (0.5, 1.75, 0.4), "toy": (0.2, 0.2, 0.2),
    "kitchen": (0.1, 0.15, 0.1), "vehicle": (1.8, 1.4, 4.2), "statue": (0.4, 0.8, 0.4),
}  # fmt: skip

TINY = ClipOptions(2, (32, 32), seed=1, reference_error=1, reference_range=(2, 2), workers=1)


def write_box(folder, width, height, depth, **part) -> None:
    """A model of one part: a box on the ground."""
    folder.mkdir(parents=True)
    mesh = meshes.box((width / 2, height / 2, depth / 2))
    rows = np.concatenate([mesh.vertices + np.float32([0, height / 2, 0]), mesh.normals, mesh.uv], 1)
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{names}"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = b"".join(struct.pack("<Biii", 3, *map(int, face)) for face in mesh.faces)
    (folder / "0.ply").write_bytes(header.encode() + rows.astype("<f4").tobytes() + faces)
    document = {"parts": [{"ply": "0.ply", "base_color": [0.5, 0.3, 0.2], "roughness": 0.4, "metallic": 0.0} | part]}
    (folder / "model.json").write_text(json.dumps(document))


@pytest.fixture
def folder(tmp_path):
    """A library that a test may change."""
    return write_library(tmp_path / "library")


def write_library(library):
    """A library with one model of each category, one environment map and two pictures."""
    models = []
    for category, (w, h, d) in CATEGORIES.items():
        write_box(library / "models" / category, w, h, d)
        bbox = [[-w / 2, 0, -d / 2], [w / 2, h, d / 2]]
        entry = {"name": f"a {category} table", "path": f"models/{category}/model.json", "category": category}
        models.append(entry | {"bbox": bbox, "unit": "m", "license": "CC BY 4.0", "author": "Ada", "source": "a shop"})
    write_layers(library / "sky.exr", {"color": np.ones((16, 32, 3), np.float32)})
    grey = np.random.default_rng(0).integers(60, 200, (32, 32, 3), np.uint8)
    Image.fromarray(grey).save(library / "wood.png")
    index = {
        "models": models,
        "hdris": [{"name": "sky", "file": "sky.exr", "tags": ["outdoor"], "license": "CC0 1.0", "author": "Bo"}],
        "textures": [{"name": "wood", "file": "wood.png", "kind": "wood", "tileable": True, "license": "CC0 1.0"},
                     {"name": "print", "file": "wood.png", "kind": "poster", "license": "CC0 1.0"}],
    }  # fmt: skip
    (library / "index.json").write_text(json.dumps(index))
    read_library.cache_clear()
    return library


def change(folder, kind: str, **entry) -> None:
    """Rewrite keys of the first entry of a kind; None removes one."""
    path = folder / "index.json"
    index = json.loads(path.read_text())
    index[kind][0] = {key: value for key, value in (index[kind][0] | entry).items() if value is not None}
    path.write_text(json.dumps(index))
    read_library.cache_clear()


# --- the index --------------------------------------------------------------------------------------------------------


def test_an_index_is_read(folder):
    library = read_library(folder)
    assert [len(kind) for kind in (library.models, library.hdris, library.textures)] == [7, 1, 2]
    (part,) = load_model(library.models[0])
    assert part.mesh.vertices[:, 1].min() == pytest.approx(0, abs=1e-6)
    assert part.material.color[0, 0] == pytest.approx([0.5, 0.3, 0.2])


@pytest.mark.parametrize(
    "kind, entry, complaint",
    [
        ("models", {"path": "../model.json"}, r"a furniture table: path '\.\./model\.json' lies outside the folder"),
        ("textures", {"file": "/etc/motd"}, r"wood: file '/etc/motd' lies outside the folder"),
        ("models", {"license": None}, "a furniture table: has no 'license'; add it, or .* --allow-unlicensed"),
        ("models", {"bbox": None}, "a furniture table: has no 'bbox'"),
        ("hdris", {"tags": None}, "sky: has no 'tags'"),
        ("hdris", {"tags": [{}]}, r"sky: tags: expected text or a list of it, got \[\{\}\]"),
        ("hdris", {"file": ["sky.exr"]}, r"sky: file: expected a file name, got \['sky.exr'\]"),
        ("textures", {"file": "wood\0.png"}, r"wood: file: expected a file name, got 'wood\\x00.png'"),
        ("models", {"category": 3}, "a furniture table: category: expected text or a list of it, got 3"),
        *(
            ("models", {"bbox": box}, r"a furniture table: bbox: expected \[\[x, y, z\], \[x, y, z\]\], least and")
            for box in ("box", [], [[0, 0, 0], [1, 1]], [[1, 1, 1], [0, 0, 0]], [[0, 0, 0], [1, 1, 10**400]], {},
                        [[1, 1, 1], [1, 1, 1]])
        ),
    ],
)
def test_a_bad_entry_is_named(folder, kind, entry, complaint):
    change(folder, kind, **entry)
    with pytest.raises(InputError, match=complaint) as caught:
        read_library(folder)
    assert "\n" not in str(caught.value)


def test_the_size_of_a_model_of_several_categories_is_that_of_one_in_every_process(folder):
    change(folder, "models", category=["vehicle", "toy", "people"], unit=None)
    asset = read_library(folder).models[0]
    orders = itertools.permutations(sorted(asset.tags))
    assert [metres(replace(asset, tags=order)).max() for order in orders] == pytest.approx([LONGEST["people"]] * 6)


@pytest.mark.parametrize("models", [3, {}, [3], [None], ["table"], [[]]])
def test_an_index_of_other_things_is_one_line(folder, models):
    (folder / "index.json").write_text(json.dumps({"models": models}))
    with pytest.raises(InputError, match=r"index\.json: (models: )?expected|lists no models"):
        read_library(folder)


BAD_PARTS = (
    {"base_color": None}, {"base_color": -1}, {"base_color": [10**400, 0, 0]}, {"base_color": [1, 2, 3, 4]},
    {"roughness": None}, {"roughness": 1e300}, {"metallic": {}}, {"normal": [1, {}]}, {"alpha": 3},
    {"emissive": 3}, {"emissive": "x"}, {"emissive": {"rgb": [1, 2, 3], "scale": 1e300}}, {"transmission": [1, 2]},
    {"alpha": {"map": 3}}, {"ior": "x"}, {"ply": 3}, {"ply": "a\0"}, {"ply": ".."},
)  # fmt: skip


@pytest.mark.parametrize("part", BAD_PARTS, ids=str)
def test_a_damaged_model_is_one_line(folder, part):
    path = folder / "models" / "furniture" / "model.json"
    document = json.loads(path.read_text())
    document["parts"][0] |= part
    path.write_text(json.dumps(document, default=str))
    with pytest.raises(InputError, match="furniture") as caught:
        load_model(read_library(folder).models[0])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kept", ["vertices", "nothing"])
def test_a_model_without_faces_is_one_line(folder, kept):
    path = folder / "models" / "furniture" / "model.json"
    document = json.loads(path.read_text())
    if kept == "nothing":
        path.write_text(json.dumps(document | {"parts": []}))
    else:
        mesh = path.with_name("0.ply")
        header, rows = mesh.read_bytes().split(b"end_header\n", 1)
        mesh.write_bytes(re.sub(rb"element face \d+", b"element face 0", header) + b"end_header\n" + rows[: 24 * 32])
    with pytest.raises(InputError, match=r"furniture.* no faces") as caught:
        load_model(read_library(folder).models[0])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("line", ["element 24", "element vertex -1", "element vertex " + "9" * 30, "element point 24"])
def test_a_damaged_mesh_is_one_line(folder, line):
    path = folder / "models" / "furniture" / "0.ply"
    path.write_bytes(path.read_bytes().replace(b"element vertex 24", line.encode()))
    with pytest.raises(InputError, match="not a readable PLY mesh"):
        load_model(read_library(folder).models[0])


@pytest.mark.parametrize("name", ["models/furniture/model.json", "models/furniture/0.ply", "wood.png", "sky.exr"])
def test_a_fifo_among_the_assets_does_not_hang(folder, name):
    (folder / name).unlink()
    os.mkfifo(folder / name)
    library = read_library(folder)
    with pytest.raises(InputError, match="not a regular file"):
        load_model(library.models[0])
        load_hdri(library.hdris[0])
        read_picture(library.textures[0].file)


def test_assets_of_one_name_are_credited_each(folder):
    index = json.loads((folder / "index.json").read_text())
    name = index["models"][0]["name"]
    index["textures"] = [entry | {"name": name, "author": "Cy"} for entry in index["textures"]]
    (folder / "index.json").write_text(json.dumps(index))
    library = read_library(folder)
    assert [a.name for a in library.textures] == [f"{name} (texture)", f"{name} (texture) (texture)"]
    b = Composer(library, np.random.default_rng(0))
    b.surface("wood")
    b.put(library.models[0], (0, 0, 0), 0)
    assert [(key, entry["author"]) for key, entry in b.used.items()] == [(f"{name} (texture)", "Cy"), (name, "Ada")]


def test_unknown_licences_are_used_on_request_only(folder, tmp_path, capsys):
    change(folder, "models", license=None)
    assert len(read_library(folder, allow_unlicensed=True).models) == 7
    with pytest.raises(SystemExit):
        main(["clips", "--out", str(tmp_path / "out"), "--assets", str(folder)])
    assert "has no 'license'" in capsys.readouterr().err


def test_no_index(tmp_path):
    with pytest.raises(InputError, match=r"index\.json: cannot be read"):
        read_library(tmp_path)
    (tmp_path / "index.json").write_text("{}")
    with pytest.raises(InputError, match="lists no models; expected one or more"):
        read_library(tmp_path)


def test_an_asset_that_does_not_load_is_skipped_and_named(folder):
    (folder / "models" / "toy" / "0.ply").write_bytes(b"ply\nnonsense")
    b = Composer(read_library(folder), np.random.default_rng(0))
    assert b.choose("toy") is None and b.choose("toy", "plant").name == "a plant table"
    assert list(b.skipped) == ["a toy table"] and "not a readable PLY mesh" in b.skipped["a toy table"]


def test_another_picture_takes_the_place_of_one_that_does_not_load(folder):
    """Of another kind where its own has no other; walls stay bare."""
    Image.new("RGB", (8, 8), "red").save(folder / "tiles.png")
    index = json.loads((folder / "index.json").read_text())
    index["textures"] += [index["textures"][0] | {"name": "tiles", "file": "tiles.png", "kind": "tile"}]
    index["hdris"] += [index["hdris"][0] | {"name": "stars", "file": "stars.exr", "tags": ["night"]}]
    (folder / "index.json").write_text(json.dumps(index))
    (folder / "wood.png").write_text("nonsense")  # the poster is this file, too
    b = Composer(read_library(folder), np.random.default_rng(0))
    b.picture((0, 0, 0), (1, 0, 0), (0, 1, 0))
    assert [*b.skipped] == ["print"] and not b.objects
    b.surface("wood")
    b.sky("night")
    assert [*b.skipped] == ["print", "wood", "stars"] and [*b.used] == ["tiles", "sky"]
    (folder / "tiles.png").write_text("nonsense")
    placing._picture.cache_clear()
    with pytest.raises(InputError, match=r"none of the assets of one kind can be loaded: .*tiles\.png"):
        b.surface("tile")


# --- compositions -----------------------------------------------------------------------------------------------------


def test_things_stand_on_the_ground_and_beside_each_other(folder):
    library, seen = read_library(folder), set()
    for seed in range(24):
        c = compose(library, seed)
        seen.add(c.scene.facts["place"])
        meshes_of = {o.id: o.mesh.vertices for o in c.scene.objects}
        for thing in c.things:
            bottom = min(meshes_of[id][:, 1].min() for id in thing.ids)
            tops = [other.top for other in c.things if other.top] + [0.0, 0.06, 0.12, 0.75]
            pedestals = [o.mesh.vertices[:, 1].max() for o in c.scene.objects if o.name == "pedestal"]
            assert min(abs(bottom - top) for top in (*tops, *pedestals)) < 2e-3, (seed, thing.asset.name)
        assert len({o.id for o in c.scene.objects}) == len(c.scene.objects)
        assert (
            c.scene.facts["assets"]["a plant table"]["author"] == "Ada"
            if "a plant table" in c.scene.facts["assets"]
            else True
        )
    assert seen == set(KINDS)


def test_a_seed_is_a_composition(folder):
    library = read_library(folder)
    a, b = compose(library, 5).scene, compose(library, 5).scene
    assert a.facts == b.facts and len(a.objects) == len(b.objects)
    assert all(np.array_equal(x.mesh.vertices, y.mesh.vertices) for x, y in zip(a.objects, b.objects, strict=True))


def test_takes_differ_and_their_motions_are_exact(folder):
    """Features of a take that is filmed after others are those of its scene alone."""
    c = compose(read_library(folder), 3)
    stage = Stage(c.scene)
    takes = [compose_take(c, stage.mitsuba, np.random.default_rng([3, k]), 6, 320) for k in range(3)]
    assert len({take.camera(0).to_world.tobytes() for take in takes}) == 3
    layers = [features(stage.direct(take), 2, (24, 40)) for take in takes][-1]
    alone = features(Stage(takes[-1]), 2, (24, 40))
    for name in ("position", "normal", "id", "motion", "motion_next"):
        np.testing.assert_allclose(layers[name], alone[name], atol=1e-4, err_msg=name)
    for take in takes:
        place = take.camera(2.5).to_world[:3, 3]
        assert (place > c.low - 1).all() and (place < c.high + 1).all()


ROOM = """<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="60"/>
    <transform name="to_world"><lookat origin="0, 1, 1.8" target="0, 1, 0" up="0, 1, 0"/></transform></sensor>
  <shape type="cube" id="walls"><boolean name="flip_normals" value="true"/>
    <transform name="to_world"><scale x="2" y="1.5" z="2"/><translate y="1.5"/></transform></shape>
  <shape type="cube" id="crate"><transform name="to_world"><scale value="0.3"/><translate y="0.3"/></transform></shape>
</scene>"""


def test_scene_files_are_filmed_from_other_places(tmp_path):
    (tmp_path / "scene.xml").write_text(ROOM)
    (tmp_path / "motion.toml").write_text('[[object]]\nshapes = ["crate"]\nvelocity = [0.1, 0, 0]\nspin = 2')
    scene = open_file(tmp_path / "scene.xml", tmp_path / "motion.toml")
    stage = Stage(scene)
    takes = [film_take(scene, stage.mitsuba, np.random.default_rng(k), 8, 320) for k in range(4)]
    places = np.stack([take.camera(3.5).to_world[:3, 3] for take in takes])
    assert (np.abs(places - (0, 1.5, 0)) < (2, 1.5, 2)).all() and len(np.unique(places, axis=0)) == 4
    speeds = {take.objects[0].motion.velocity[0] for take in takes}
    assert len(speeds) == 4 and all(0.04 <= abs(speed) <= 0.2 for speed in speeds)
    ahead, away = CameraPath((0, 1, 1.8), (0, 1, 0))(0), CameraPath((0, 1, 1.8), (0, 1, 3))(0)
    assert shapes_in_view(stage.mitsuba, ahead) == 2 and shapes_in_view(stage.mitsuba, away) == 1


# --- light ------------------------------------------------------------------------------------------------------------


def card_over_floor(alpha: float) -> Scene:
    """A floor lit by a sun from above, under a large horizontal card of this opacity; seen from below the card."""
    floor = Object(1, "floor", meshes.quad((-9, 0, 9), (18, 0, 0), (0, 0, -18)), plain(0.5, 1.0))
    card = replace(plain(0.2), alpha=np.full((4, 4, 1), alpha, np.float32))
    roof = Object(2, "card", meshes.quad((-9, 3, 9), (18, 0, 0), (0, 0, -18)), card)
    return Scene("card", (floor, roof), CameraPath((0, 2, 0), (0, 0, -0.01)), sun=Sun((0.0, 1.0, 0.0), (2.0, 2.0, 2.0)))


def test_holes_let_light_and_sight_through():
    direct = {}
    for alpha in (0.0, 0.25, 1.0):
        beauty, indirect = radiance(Stage(card_over_floor(alpha)), 0, (16, 16), 64, 0, NOISY, 2)
        direct[alpha] = float((beauty - indirect).mean())
    assert direct[1.0] < 1e-6 and direct[0.25] == pytest.approx(0.75 * direct[0.0], rel=1e-3)
    scene = card_over_floor(0.25)
    above = replace(scene, camera=CameraPath((0, 6, 0), (0, 0, -0.01)))
    stage = Stage(above)
    layers = features(stage, 0, (32, 32))
    assert (layers["id"] == 1).mean() == pytest.approx(0.75, abs=0.05)
    np.testing.assert_allclose(layers["depth"][layers["id"] == 1], 6, rtol=0.5)
    beauty, _ = radiance(stage, 0, (32, 32), 1, 0, NOISY, 2)
    lit = (layers["id"] == 2)[..., 0]
    bright, dark = beauty[~lit].mean(), beauty[lit].mean()
    assert dark < 0.6 * bright  # light and features of a sample pass the same holes


def test_a_lens_blurs_what_is_not_in_focus():
    bars = Object(1, "bars", meshes.bars(4, 4, 8, 0.25).transform(Motion(velocity=(0, 0, -4))(1)), plain(0.5))
    wall = Object(2, "wall", meshes.quad((-8, -8, -9), (16, 0, 0), (0, 16, 0)), plain(0.5))
    share = {}
    for focus in (4.0, 1.5):
        camera = CameraPath((0, 0, 0), (0, 0, -4), aperture=0.15, focus=focus)
        stage = Stage(Scene("bars", (bars, wall), camera))
        mixed = np.stack([features(stage, 0, (48, 48), seed=k)["id"] for k in range(8)]) == 1
        share[focus] = float(np.logical_and(mixed.any(0), ~mixed.all(0)).mean())
    assert share[1.5] > 1.5 * share[4.0]


# --- sets -------------------------------------------------------------------------------------------------------------


def test_a_set_of_assets_is_resumed_and_credits_its_authors(folder, tmp_path):
    """With a lead-in all its clips are as short as this."""
    (folder / "models" / "kitchen" / "0.ply").write_bytes(b"ply\nnonsense")
    options = replace(TINY, frames=2, lead_in=1, assets=str(folder))
    card = render_here(tmp_path / "out", options, lambda *_: None)
    assert card["clips"] == 2 and card["sources"] == {"composition of assets": 2}
    facts = [read_facts(clip_path(tmp_path / "out", i)) for i in range(2)]
    for f in facts:
        assert tuple(f["window"][2:]) in VIEWS
        assert f["samples"] == f["spp"] and f["frames"] == 2 and f["lead_in"] == 1
    text = (tmp_path / "out" / "DATA.md").read_text()
    assert "### Assets: CC BY 4.0" in text and "**Ada**" in text
    if any(f["skipped"] for f in facts):
        assert "a kitchen table: " in text
    before = ClipDataset(tmp_path / "out").load(1)
    assert (before[0].samples == facts[1]["spp"]).all()
    clip_path(tmp_path / "out", 1).unlink()
    render_here(tmp_path / "out", options, lambda *_: None)
    for a, b in zip(before, ClipDataset(tmp_path / "out").load(1), strict=True):
        assert all(tensor.equal(getattr(b, name)) for name, tensor in a.layers())


def test_takes_of_assets_have_lengths_of_their_own(folder):
    options = replace(TINY, frames=2, seed=9, assets=str(folder))
    ((number, take),) = draw_takes(0, options, {0})
    assert number == 0 and len(take.found.motion) == take.frames >= 8 and take.view in VIEWS


def test_sets_of_other_samples_or_lengths_are_not_mixed(tmp_path):
    stills = ClipOptions(2, (32, 32), frames=1, assets="library")
    facts = {"generator": 3, "seed": 0, "size": [32, 32], "max_depth": 6, "frames": 1}
    for was, change, complaint in (
        (stills, {"most_spp": 1}, "most_spp = None, not 1"),
        (replace(stills, most_spp=1), {"most_spp": None}, "most_spp = 1, not None"),
        (stills, {"spp": 2}, "least_spp = 1, not 2"),
        (stills, {"frames": 10}, "stills = True, not False"),
    ):
        header = {"clip": json.dumps(facts | {"scenes_are_of": was.scenes_are_of()})}
        save_file({"depth": np.zeros(1)}, clip_path(tmp_path, 0), header)
        refuse_other_options(tmp_path, was)
        with pytest.raises(InputError, match=f"clip_000000.safetensors: was rendered with {complaint}"):
            refuse_other_options(tmp_path, replace(was, **change))


def test_clips_of_scenes_without_things_are_counted(folder, tmp_path):
    index = json.loads((folder / "index.json").read_text())
    index["models"] = [entry | {"category": "of no use"} for entry in index["models"]]
    (folder / "index.json").write_text(json.dumps(index))
    read_library.cache_clear()
    lines = []
    with pytest.raises(InputError, match="no clips found"):
        render_here(tmp_path / "out", ClipOptions(2, (32, 32), workers=1, assets=str(folder)),
                     lambda done, total, line: lines.append((done, total, line)))  # fmt: skip
    assert lines[1:] == [(2, 2, "left out: 2 clips, from 0 on: nothing is seen in their scenes")]


def test_a_library_without_meshes_is_refused(folder, tmp_path):
    models = list(folder.glob("models/*/0.ply"))
    for path in models[1:]:
        path.unlink()
    require_models(read_library(folder))
    models[0].write_text("version https://git-lfs.github.com/spec/v1")
    load_model.cache_clear()
    options = ClipOptions(2, (32, 32), assets=str(folder))
    with pytest.raises(InputError, match=rf"library: none of its {len(models)} models can be loaded: .*\.ply: "):
        render_here(tmp_path / "out", options, lambda *_: None)
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def stills(tmp_path_factory):
    """Two stills of a library, and their options."""
    library = write_library(tmp_path_factory.mktemp("assets") / "library")
    options = replace(TINY, frames=1, reference_range=(16, 16), assets=str(library))
    render_here(library.parent / "stills", options, lambda *_: None)
    return library.parent / "stills", options


def test_stills_of_assets_are_single_frames(stills):
    path, options = stills
    clips = ClipDataset(path)
    assert [len(clips.load(i)) for i in range(len(clips))] == [1, 1]
    assert options.clips_per_scene > ClipOptions(assets="x").clips_per_scene


def test_a_set_of_assets_has_no_more_samples_than_allowed():
    draws = {}
    for most in (None, 16, 7, 4):
        options, rng = ClipOptions(spp=4, assets="x", most_spp=most), np.random.default_rng(0)
        draws[most] = {draw_samples(options, rng) for _ in range(200)}
    assert draws == {None: {4, 8, 16, 32, 64, 128, 256}, 16: {4, 8, 16}, 7: {4}, 4: {4}}


def test_repeats_of_a_still_differ_in_noise_alone(stills, tmp_path):
    path, options = stills
    render_here(tmp_path, replace(options, count=1, repeats=3), lambda *_: None)
    (once,), thrice = ClipDataset(path).load(0), ClipDataset(tmp_path).load(0)
    assert len(thrice) == 3
    for frame in thrice:
        assert frame.reference.equal(once.reference) and frame.reference_half.equal(once.reference_half)
        assert not frame.motion.any() and not frame.motion_next.any()
    assert thrice[0].radiance.equal(once.radiance) and not thrice[1].radiance.equal(thrice[2].radiance)
    assert {"albedo_reference", "normal_reference"} <= read_layers(clip_path(path, 0)).keys()
    with pytest.raises(InputError, match="was rendered with frames = 3, not 1"):
        render_here(tmp_path, options, lambda *_: None)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ("--assets x --frames 5", "--frames: is for generated scenes, not for --assets"),
        ("--allow-unlicensed", "--allow-unlicensed: goes with --assets"),
        ("--assets x --sun 1", "--sun: is for generated scenes, not for --assets"),
        ("--assets x --generator 1", "--assets: goes with --generator 2 and 3"),
        ("--assets x --repeats 2", "--repeats: is for stills"),
        ("--most-spp 1", "--most-spp: goes with --assets"),
        ("--assets x --spp 4 --most-spp 2", "--most-spp: expected 4 (--spp) or more, got 2"),
        ("--assets x --size 724", "clips of 724×724: are cut from pictures of 1280×720 and more; expected 1280×720"),
        ("--assets nowhere", "cannot be read: No such file"),
    ],
)
def test_wrong_options(tmp_path, capsys, arguments, message):
    with pytest.raises(SystemExit, match="2"):
        main(["clips", *arguments.split(), "--out", str(tmp_path / "out")])
    assert message in capsys.readouterr().err and not (tmp_path / "out").exists()
