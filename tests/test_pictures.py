"""Pictures from files as textures: the same every time, nothing else changed, and their licences in the data card."""

import numpy as np
import pytest
import torch
from PIL import Image

from rtdenoise.cli.main import main
from rtdenoise.data.clip_file import clip_path, read_facts
from rtdenoise.data.clips import ClipDataset
from rtdenoise.errors import InputError
from rtdenoise.render.card import write_card
from rtdenoise.render.options import ClipOptions
from rtdenoise.render.scene_clips import render_group
from rtdenoise.render.scenes import wide
from rtdenoise.render.scenes.named import open_scene
from rtdenoise.render.scenes.pictures import find_pictures, hang
from rtdenoise.render.scenes.textures import SIZE


@pytest.fixture
def folder(tmp_path):
    """Three pictures: plain sRGB red (JPEG), a fine grey ramp with alpha (PNG), noise that is larger than needed."""
    folder = tmp_path / "photos"
    folder.mkdir()
    Image.new("RGB", (40, 60), (188, 0, 0)).save(folder / "b red.jpg", quality=95)
    ramp = np.broadcast_to(np.linspace(0, 255, 256).astype(np.uint8)[None, :, None], (200, 256, 4)).copy()
    Image.fromarray(ramp).save(folder / "a ramp.png")
    noise = np.random.default_rng(0).integers(0, 256, (1300, 1200, 3), np.uint8)
    Image.fromarray(noise).save(folder / "c noise.PNG", compress_level=1)
    (folder / "LICENSE.txt").write_text("Photographs by Nobody, CC0.\n")
    return folder


def test_a_texture_is_a_window_in_linear_light(folder):
    pictures = find_pictures(folder)
    assert pictures.names == ("a ramp.png", "b red.jpg", "c noise.PNG")
    red = pictures.texture("b red.jpg", np.random.default_rng(0))
    assert red.shape == (SIZE, SIZE, 3) and red.dtype == np.float32
    assert red[..., 0].mean() == pytest.approx(0.503, abs=0.01)  # 188 of 255 is half of the light
    assert red[..., 1:].max() < 0.03
    ramp = pictures.texture("a ramp.png", np.random.default_rng(1))
    assert (np.diff(ramp[0, :, 0]) >= 0).all() and np.allclose(ramp[0], ramp[-1], atol=1e-5)  # not turned, not mirrored
    assert 0.02 <= ramp.min() < ramp.max() <= 0.92
    again = pictures.texture("c noise.PNG", np.random.default_rng(2))
    assert np.array_equal(again, pictures.texture("c noise.PNG", np.random.default_rng(2)))
    assert not np.array_equal(again, pictures.texture("c noise.PNG", np.random.default_rng(3)))


def test_only_textures_change(folder):
    plain = wide.procedural(11)
    dressed = hang(plain, find_pictures(folder), np.random.default_rng(0))
    changed = [not np.array_equal(a.material.texture, b.material.texture)
               for a, b in zip(plain.objects, dressed.objects, strict=True)]  # fmt: skip
    assert 0.1 < np.mean(changed) < 0.8
    assert set(dressed.facts["pictures"]["files"]) <= {"a ramp.png", "b red.jpg", "c noise.PNG"}
    for a, b in zip(plain.objects, dressed.objects, strict=True):
        assert (a.id, a.mesh, a.motion, a.emission) == (b.id, b.mesh, b.motion, b.emission)
        assert (a.material.kind, a.material.roughness) == (b.material.kind, b.material.roughness)
    backdrop = next(s for s in map(wide.procedural, range(99)) if s.facts["kind"] == "dark to light")
    for seed in range(9):  # black beside white stays what it is
        before, after = backdrop, hang(backdrop, find_pictures(folder), np.random.default_rng(seed))
        for a, b in zip(before.objects, after.objects, strict=True):
            assert a is b or a.name != "backdrop"


def test_a_set_with_pictures_is_the_same_again_and_names_them(folder, tmp_path):
    options = ClipOptions(1, (32, 32), 2, seed=3, reference_range=(2, 4), workers=1, textures=str(folder))
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        render_group(tmp_path / name, 0, options)
        if name == "one":
            (folder / "LICENSE.txt").unlink()
    (one,), (two,) = (list(map(ClipDataset(tmp_path / name).load, range(1))) for name in ("one", "two"))
    for a, b in zip(one, two, strict=True):
        assert all(torch.equal(tensor, getattr(b, layer)) for layer, tensor in a.layers())

    used = read_facts(clip_path(tmp_path / "one", 0))["pictures"]["files"]
    card = write_card(tmp_path / "one", "rtdenoise render")
    assert card["pictures"]["photos"] == {"clips": 1, "files": used, "licence": "Photographs by Nobody, CC0.\n"}
    assert used
    text = (tmp_path / "one" / "DATA.md").read_text()
    assert "## Pictures from photos" in text and "Photographs by Nobody, CC0." in text
    assert "third-party" not in text
    write_card(tmp_path / "two", "rtdenoise render")
    assert "No LICENSE.txt lay in the folder" in (tmp_path / "two" / "DATA.md").read_text()


def test_bad_folders_and_pictures(folder, tmp_path, capsys):
    with pytest.raises(InputError, match="no such folder"):
        find_pictures(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"no pictures found; expected \.png"):
        find_pictures(tmp_path / "empty")
    with pytest.raises(InputError, match="goes with wide:SEED, not with 'sample'"):
        open_scene("sample", None, folder)
    (folder / "d.png").write_bytes(b"no picture at all")
    find_pictures.cache_clear()
    with pytest.raises(InputError, match=r"d\.png: not a readable picture"):
        find_pictures(folder)
    Image.new("I;16", (64, 64)).save(folder / "d.png")
    with pytest.raises(InputError, match=r"d\.png: is 64×64 of mode I;16, expected 8 bits"):
        find_pictures(folder)
    whole = (folder / "a ramp.png").read_bytes()
    (folder / "d.png").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"d\.png: not a readable picture"):
        find_pictures(folder).texture("d.png", np.random.default_rng(0))
    with pytest.raises(SystemExit):
        main(["clips", "--out", str(tmp_path / "out"), "--generator", "1", "--textures", str(folder)])
    assert "--textures: goes with --generator 2 and 3" in capsys.readouterr().err
