"""Output of `denoise` for native sequences: recombination, layouts, refusals."""

import json
import math
from fractions import Fraction

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from synthetic import make_frames, write_sequence

from rtdenoise.cli.denoise import write_preview
from rtdenoise.cli.main import main
from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.data.opening import open_sequence
from rtdenoise.data.output import recombined
from rtdenoise.errors import InputError
from rtdenoise.run import preview
from rtdenoise.run.denoise import Options, denoise
from rtdenoise.run.torch_backend import TorchBackend

H, W = 5, 7


def native(path, color, indirect):
    layers = {"color": color, "indirect": indirect, "albedo": np.full((H, W, 3), 0.25)}
    write_layers(path, layers, dtypes=dict.fromkeys(layers, "float"))
    return open_sequence(path, signal="indirect")


def rgb(path):
    return np.stack(list(read_channels(path, "RGB").values()))


def test_native_indirect_light_contains_the_albedo(tmp_path):
    """beauty = color - indirect_noisy + indirect_denoised"""
    sequence = native(tmp_path / "1.exr", np.full((H, W, 3), 3.0), np.full((H, W, 3), 2.0))
    image = np.full((1, 3, H, W), 0.5, np.float32)
    assert np.array_equal(recombined(sequence, 0, sequence.read(0), image), np.full((1, 3, H, W), 1.5))


def test_direct_light_passes_through(tmp_path):
    """Direct light passes unchanged: to the bit where indirect light is black, within rounding elsewhere."""
    random = np.random.default_rng(0).random
    direct, noisy = random((H, W, 3), np.float32), random((H, W, 3), np.float32) * 4
    noisy[:, : W // 2] = 0
    sequence = native(tmp_path / "1.exr", direct + noisy, noisy)
    image = random((1, 3, H, W), np.float32)
    image[..., : W // 2] = 0
    beauty = recombined(sequence, 0, sequence.read(0), image)
    direct = np.moveaxis(direct, 2, 0)[None]
    assert np.array_equal(beauty[..., : W // 2], direct[..., : W // 2])
    assert np.allclose(beauty, direct + image, rtol=0, atol=5 * 2.0**-22)  # values of up to 5, rounded twice


def test_recombined_is_finite_and_not_negative(tmp_path):
    color, indirect = np.full((H, W, 3), 3.0), np.full((H, W, 3), 2.0)
    color[0, 0], indirect[0, 0] = np.nan, np.nan
    color[0, 1], indirect[0, 1] = np.inf, np.inf
    indirect[0, 2] = 4  # more than the beauty
    sequence = native(tmp_path / "1.exr", color, indirect)
    beauty = recombined(sequence, 0, sequence.read(0), np.full((1, 3, H, W), 0.5, np.float32))
    assert beauty[0, 0, 0, :4].tolist() == [0.5, 0.5, 0, 1.5]


def test_recombining_the_beauty_changes_nothing(tmp_path, model):
    shot = write_sequence(tmp_path / "shot", make_frames())
    for name, recombine in (("a", False), ("b", True)):
        denoise(str(shot), tmp_path / name, Options(model=model, recombine=recombine))
    assert np.array_equal(rgb(tmp_path / "a" / "frame.0003.exr"), rgb(tmp_path / "b" / "frame.0003.exr"))


@pytest.mark.parametrize("references", [True, False])
def test_the_preview_of_the_beauty_shows_the_beautys_reference(tmp_path, model, references, monkeypatch):
    (tmp_path / "shot").mkdir()
    for frame in make_frames(2):
        layers = {layer: tensor[0].permute(1, 2, 0).numpy() for layer, tensor in frame.layers()}
        layers["color"], layers["indirect"] = layers["radiance"] * 3, layers.pop("radiance")
        layers["indirect_reference"] = layers.pop("reference")
        if references:
            layers["reference"] = layers["albedo"] * 7
        write_layers(tmp_path / "shot" / f"{frame.number}.exr", layers, dtypes={"reference": "float"})
    shown = []
    monkeypatch.setattr(preview, "strip", lambda panels, scale: shown.append(panels) or Image.new("RGB", (8, 8)))
    options = Options("indirect", model, recombine=True)
    denoise(str(tmp_path / "shot"), tmp_path / "out", options)
    write_preview(options, str(tmp_path / "shot"), tmp_path / "out")
    assert len(shown) == 2
    for panels, number in zip(shown, (1, 0), strict=True):
        assert list(panels) == ["noisy", "denoised", *(["reference"] if references else [])]
        noisy = rgb(tmp_path / "shot" / f"{number}.exr")
        np.testing.assert_allclose(panels["noisy"][0], noisy, rtol=1e-5)
        if references:
            expected = read_channels(tmp_path / "shot" / f"{number}.exr", [f"reference.{c}" for c in "RGB"])
            assert np.array_equal(panels["reference"][0], np.stack(list(expected.values())))


def test_source_layout_of_native_files(tmp_path, model):
    shot = write_sequence(tmp_path / "shot", make_frames())
    options = Options("indirect", model, layout="source", recombine=True, float32=True)
    denoise(str(shot), tmp_path / "out", options)
    names = [f"indirect.{c}" for c in "RGB"]
    before, after = (read_channels(folder / "frame.0001.exr", names) for folder in (shot, tmp_path / "out"))
    expected = rgb(shot / "frame.0001.exr") + np.stack([after[name] - before[name] for name in names])
    np.testing.assert_allclose(rgb(tmp_path / "out" / "frame.0001.exr"), expected.clip(0), atol=1e-6)


def test_an_interrupted_run_with_another_layout_is_refused(tmp_path, model):
    shot = write_sequence(tmp_path / "shot", make_frames())
    denoise(str(shot), tmp_path / "out", Options(model=model))
    with pytest.raises(InputError, match="other options"):
        denoise(str(shot), tmp_path / "out", Options(model=model, layout="source"))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"layout": "sauce"}, "unknown layout 'sauce': known are plain, source"),
        ({"layout": "source", "keep": ("albedo",)}, "layout 'source' passes every channel on: leave --keep out"),
        ({"recombine": True, "signal": "indirect"}, "--recombine needs the beauty, the file has "),
        ({"keep": ("albedo", "foo")}, "no 'foo' to keep; the file has "),
    ],
)
def test_what_cannot_be_written_is_refused_before_the_work(tmp_path, model, options, expected):
    shot = tmp_path / "shot"
    shot.mkdir()
    for frame in make_frames(2):
        layers = {layer: tensor[0].permute(1, 2, 0).numpy() for layer, tensor in frame.layers()}
        layers["indirect"] = layers.pop("radiance")
        if "signal" not in options:
            layers["color"] = layers["indirect"]
        write_layers(shot / f"{frame.number}.exr", layers)
    with pytest.raises(InputError) as caught:
        denoise(str(shot), tmp_path / "out", Options(model=model, **options))
    assert expected in str(caught.value) and "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


PLACE = {"dataWindow": ((-8, 4), (23, 27)), "displayWindow": ((0, 0), (15, 15)), "pixelAspectRatio": 2.0,
         "chromaticities": (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)}  # fmt: skip


@pytest.fixture
def placed(tmp_path):
    """Writes frames of a shot with further attributes in their headers: (shot, function of an attribute list)."""

    def write(*attributes, brighter=1.0):
        for frame, attribute in zip(make_frames(len(attributes)), attributes, strict=True):
            layers = {layer: tensor[0].permute(1, 2, 0).numpy() for layer, tensor in frame.layers()}
            layers["color"] = layers.pop("radiance") * brighter
            path = tmp_path / "shot" / f"f.{frame.number}.exr"
            write_layers(path, layers, dtypes={"color": "float"}, attributes=attribute)
        return str(path.parent)

    (tmp_path / "shot").mkdir()
    return write


@pytest.mark.parametrize("layout", ["plain", "source"])
def test_the_picture_stays_where_it_was(placed, tmp_path, model, layout):
    denoise(placed(PLACE, PLACE), tmp_path / "out", Options(model=model, layout=layout))
    header = OpenEXR.File(str(tmp_path / "out" / "f.1.exr")).header()
    for name, value in PLACE.items():
        assert np.allclose(header[name], value), name


@pytest.mark.parametrize("layout", ["plain", "source"])
def test_what_the_header_says_of_the_picture_lives_on(placed, tmp_path, model, layout):
    """That of each frame: time and camera differ."""

    def attributes(number):
        time = OpenEXR.TimeCode(1, 2, 3, number, *[0] * 14)
        return {
            "colorInteropID": "lin_rec709_scene", "whiteLuminance": 100.0, "framesPerSecond": Fraction(24000, 1001),
            "timeCode": time, "comments": f"take {number}", "worldToCamera": np.eye(4, dtype=np.float32) * number,
            "isoSpeed": 400.0, "screenWindowCenter": np.float32([0.25, 0]), "arnold/names": ["a", "b"],
        }  # fmt: skip

    more = {"cryptomatte/1/name": "of channels that are not there", "compression": OpenEXR.PIZ_COMPRESSION}
    denoise(placed(*(attributes(i) | more for i in range(2))), tmp_path / "out", Options(model=model, layout=layout))
    for number in range(2):
        header = OpenEXR.File(str(tmp_path / "out" / f"f.{number}.exr")).header()
        for name, value in attributes(number).items():
            assert str(header[name]) == str(value) or np.allclose(header[name], value), name
        assert ("cryptomatte/1/name" in header) == (layout == "source")
        assert header["compression"] == OpenEXR.ZIP_COMPRESSION


@pytest.mark.parametrize("apart", [False, True], ids=["one part", "parts"])
def test_cryptomatte_that_is_kept_says_what_it_is(tmp_path, model, apart):
    """Compositors find its channels by these attributes alone."""
    ids = np.random.default_rng(0).random((8, 8)).astype(np.float32)
    picture, mattes = dict.fromkeys("RGB", ids), {}
    about = {f"cryptomatte/{i}/{key}": f"{key} of {i}" for i in (1, 2) for key in ("conversion", "manifest")}
    for i, name in enumerate(("View.CryptoObject", "View.CryptoAsset"), 1):
        mattes |= {f"{name}00.{c}": ids for c in "rgba"}
        about[f"cryptomatte/{i}/name"] = name
    (tmp_path / "shot").mkdir()
    parts = [OpenEXR.Part({}, picture, "color"), OpenEXR.Part(dict(about), mattes, "mattes")]
    one = OpenEXR.File(dict(about), picture | mattes)
    (OpenEXR.File(parts) if apart else one).write(str(tmp_path / "shot" / "f.0.exr"))
    for keep, expected in (("all", "12"), ("CryptoObject00", "1"), ("View.CryptoAsset00", "2")):
        denoise(str(tmp_path / "shot"), tmp_path / keep, Options(model=model, keep=(keep,)))
        header = OpenEXR.File(str(tmp_path / keep / "f.0.exr")).header()
        found = {name: value for name, value in header.items() if name.startswith("cryptomatte/")}
        assert found == {name: value for name, value in about.items() if name.split("/")[1] in expected}


@pytest.mark.parametrize(("options", "kept"), [
    ({}, True), ({"signal": "indirect"}, False), ({"signal": "indirect", "recombine": True}, True),
])  # fmt: skip
def test_the_alpha_of_the_beauty_lives_on(tmp_path, model, options, kept):
    shot = write_sequence(tmp_path / "shot", make_frames(2))
    alpha = np.random.default_rng(0).random((24, 32)).astype(np.float16)
    for path in shot.iterdir():
        channels = read_header(path).channels
        layers = read_channels(path, list(channels), as_stored=True) | {"A": alpha}
        write_layers(path, layers, dtypes=channels | {"A": "half"})
    denoise(str(shot), tmp_path / "out", Options(model=model, float32=True, **options))
    header = read_header(tmp_path / "out" / "frame.0001.exr")
    assert header.channels == {**({"A": "half"} if kept else {}), **dict.fromkeys("BGR", "float")}
    if kept:
        assert np.array_equal(read_channels(header.path, ["A"])["A"], alpha.astype(np.float32))


@pytest.mark.parametrize(
    "odd",
    [{"pixelAspectRatio": 1e-6}, {"displayWindow": ((-(1 << 29), 0), (1 << 29, 7))}, {"chromaticities": (1e30,) * 8},
     {"whiteLuminance": float("nan")}, {"comments": ""}],
    ids=lambda attributes: next(iter(attributes)),
)
def test_odd_attributes_do_no_harm(placed, tmp_path, model, odd):
    assert denoise(placed(odd), tmp_path / "out", Options(model=model)).written == 1


def test_a_data_window_that_moves_is_refused(placed, tmp_path, model):
    moved = {"dataWindow": ((0, 4), (31, 27))}
    with pytest.raises(InputError, match=r"f.1.exr: its data window begins at \(0, 4\), that of f.0.exr at \(-8, 4\);"):
        denoise(placed(PLACE, moved), tmp_path / "out", Options(model=model))


@pytest.mark.parametrize("layout", ["plain", "source"])
def test_what_half_floats_do_not_hold_is_written_in_32_bits(placed, tmp_path, model, layout):
    shot = placed({}, {}, brighter=1e6)
    denoise(shot, tmp_path / "half", Options(model=model, layout=layout))
    denoise(shot, tmp_path / "float", Options(model=model, layout=layout, float32=True))
    half, full = (rgb(tmp_path / name / "f.1.exr") for name in ("half", "float"))
    assert full.max() > 65504 and np.array_equal(half, full)


# --- the input is never written to ------------------------------------------------------------------------------------


def links_to(shot, folder, link=lambda new, old: new.symlink_to(old)):
    folder.mkdir()
    for path in sorted(shot.iterdir()):
        link(folder / path.name, path)
    return folder


def refusal(source, out, **options):
    with pytest.raises(InputError) as caught:
        denoise(str(source), out, Options(model="default", **options), overwrite=True)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("layout", ["plain", "source"])
def test_a_folder_of_links_to_the_input_is_the_input(tmp_path, layout):
    shot = write_sequence(tmp_path / "shot", make_frames(2))
    links = links_to(shot, tmp_path / "links")
    before = {path: (path.is_symlink(), path.read_bytes()) for path in (*shot.iterdir(), *links.iterdir())}
    (tmp_path / "same").symlink_to(links)
    for source, out in ((links, links), (links, shot), (links, tmp_path / "same"), (tmp_path / "same", shot)):
        assert refusal(source, out, layout=layout).endswith(
            f"{out}: this folder holds the input, which is never written to; choose another --out"
        )
    assert "links/frame.0000.exr: is a file of the input" in refusal(shot, links, layout=layout)
    hard = links_to(shot, tmp_path / "hard", lambda new, old: new.hardlink_to(old))
    assert "hard/frame.0000.exr: is a file of the input" in refusal(shot, hard, layout=layout)
    assert before == {path: (path.is_symlink(), path.read_bytes()) for path in before}
    assert {path.name for path in links.iterdir()} == {path.name for path in shot.iterdir()}


@pytest.mark.parametrize("layout", ["plain", "source"])
def test_frames_that_would_be_written_to_one_file(tmp_path, layout):
    """Every frame has a folder of its own, and the same file name in it."""
    layers = {"color": 3, "albedo": 3, "normal": 3, "depth": 1, "motion": 2}
    for number in range(2):
        (tmp_path / "shot" / str(number)).mkdir(parents=True)
        write_layers(tmp_path / "shot" / str(number) / "all.exr", {k: np.ones((H, W, n)) for k, n in layers.items()})
    letters = {"color": "RGB", "albedo": "RGB", "normal": "XYZ", "depth": "Z", "motion": "XY"}
    tables = [
        f"[{layer}]\nchannels = {[('' if layer == 'color' else f'{layer}.') + c for c in names]}\n"
        "file = '{frame}/all.exr'"
        for layer, names in letters.items()
    ]
    (tmp_path / "my.toml").write_text("\n".join(tables))
    found = refusal(tmp_path / "shot", tmp_path / "out", preset=str(tmp_path / "my.toml"), layout=layout)
    assert found.startswith(
        f"{tmp_path}/shot/1/all.exr: would be written to the same file as {tmp_path}/shot/0/all.exr"
    )
    assert not (tmp_path / "out").exists()


def test_links_in_the_output_folder_are_not_followed(tmp_path, model):
    shot, out = write_sequence(tmp_path / "shot", make_frames(2)), tmp_path / "out"
    out.mkdir()
    (tmp_path / "mine").write_text("mine")
    for name in ("frame.0000.exr", "denoise.json", ".rtdenoise-state.safetensors", ".rtdenoise-probe", "preview.png"):
        (out / name).symlink_to(tmp_path / "mine")
    main(["denoise", str(shot), "--out", str(out), "--model", model, "--overwrite", "--preview"])
    assert (tmp_path / "mine").read_text() == "mine"
    assert {path.name for path in out.iterdir() if path.is_symlink()} == {".rtdenoise-probe"}


# --- what is written, and what is found again -------------------------------------------------------------------------


@pytest.mark.parametrize("layout", ["plain", "source"])
def test_a_result_that_is_not_finite_is_never_written(tmp_path, model, layout, monkeypatch):
    """Whatever went wrong before: the image is checked as it is written."""
    shot = write_sequence(tmp_path / "shot", make_frames(2))
    step = TorchBackend.step

    def broken(self, frame, history, ahead):
        image, history = step(self, frame, history)
        image[0, 1, 3, 3:5] = np.nan if frame.number else 0.5
        return image, history

    monkeypatch.setattr(TorchBackend, "step", broken)
    with pytest.raises(InputError, match=r"frame\.0001\.exr: the result has 2 pixels that are not finite"):
        denoise(str(shot), tmp_path / "out", Options(model=model, layout=layout))
    assert [path.name for path in sorted((tmp_path / "out").glob("*.exr"))] == ["frame.0000.exr"]


@pytest.mark.parametrize("options", [{"layout": "source"}, {"keep": ("all",)}], ids=["source", "keep"])
def test_nan_in_channels_that_are_passed_on_is_told(tmp_path, model, options, capsys):
    frames = make_frames(3)
    for frame in frames[1:]:
        frame.normal[0, 1, 2:4, 2] = math.nan
    shot = write_sequence(tmp_path / "shot", frames)
    arguments = ["--layout", "source"] if "layout" in options else ["--keep", "all"]
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", model, *arguments])
    assert "passed on as in the input: NaN in 4 pixels of normal.Y" in capsys.readouterr().out
    assert json.loads((tmp_path / "out" / "denoise.json").read_text())["passed_on"] == {"normal.Y": 4}
    assert denoise(str(shot), tmp_path / "out", Options(model=model, **options)).passed_on == {"normal.Y": 4}


def test_kept_channels_are_those_of_the_input_to_the_bit(tmp_path, model):
    """A float32 would round what is in whole numbers of 32 bits, and half floats end at 65504."""
    (frame,) = make_frames(1)
    size = frame.depth.shape[2:]
    layers = {name: getattr(frame, name)[0].permute(1, 2, 0).numpy() for name in ("albedo", "normal", "depth")}
    planes = {"crypto.R": np.full(size, 0xDEADBEEF, np.uint32), "fog.Z": np.full(size, np.inf, np.float16)}
    layers["color"] = frame.radiance[0].permute(1, 2, 0).numpy()
    write_layers(tmp_path / "1.exr", layers | planes, dtypes={"crypto.R": "uint", "fog.Z": "half"})
    denoise(str(tmp_path / "1.exr"), tmp_path / "out", Options(model=model, keep=("all",)))
    written = OpenEXR.File(str(tmp_path / "out" / "1.exr"), separate_channels=True).channels()
    for name, plane in planes.items():
        assert np.array_equal(written[name].pixels, plane) and written[name].pixels.dtype == plane.dtype


@pytest.mark.parametrize(
    "options", [{"keep": ("extra",)}, {"signal": "indirect", "recombine": True}], ids=["keep", "recombine"]
)
def test_a_later_frame_that_lacks_what_the_output_needs_is_refused_at_once(tmp_path, model, options):
    shot = write_sequence(tmp_path / "shot", make_frames(3))
    for i, path in enumerate(sorted(shot.glob("*.exr"))):
        layers = read_channels(path, list(read_header(path).channels))
        layers |= {f"indirect.{c}": layers[c] for c in "RGB"} | {"extra.Z": layers["R"]}
        for name in ("R", "extra.Z") if i == 2 else ():
            del layers[name]
        write_layers(path, layers, dtypes=dict.fromkeys(layers, "float"))
    what = "--keep" if "keep" in options else "--recombine"
    with pytest.raises(InputError, match=rf"lacks channel .*, which .* has and {what} needs; the file has"):
        denoise(str(shot), tmp_path / "out", Options(model=model, **({"signal": "indirect"} | options)))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("layout", ["plain", "source"])
@pytest.mark.parametrize(
    ("junk", "expected"),
    [
        (lambda path: path.write_text("junk"), "not an OpenEXR file"),
        (lambda path: path.write_bytes(b""), "damaged or replaced"),
        (lambda path: path.write_bytes(path.read_bytes()[:-9]), "damaged or replaced"),
        (lambda path: write_sequence(path.parent, make_frames(2, H=9, W=8)), "8×9 pixels"),
        (lambda path: write_layers(path, {"color": np.zeros((24, 32, 3))}), "another size in bytes"),
    ],
)
def test_a_finished_frame_that_was_replaced_is_noticed(tmp_path, model, layout, junk, expected):
    shot, out = write_sequence(tmp_path / "shot", make_frames(3)), tmp_path / "out"
    options = Options(model=model, layout=layout)
    denoise(str(shot), out, options)
    junk(out / "frame.0001.exr")
    with pytest.raises(InputError, match=expected) as caught:
        denoise(str(shot), out, options)
    assert "--overwrite" in str(caught.value) and "\n" not in str(caught.value)
    assert denoise(str(shot), out, options, overwrite=True).written == 3
    assert denoise(str(shot), out, options).skipped == 3
