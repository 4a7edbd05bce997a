"""Inspection: facts are counted right, and motion vectors in the wrong convention are called by its name."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic import make_frames, write_sequence

from rtdenoise.cli.main import main
from rtdenoise.data.exr import write_layers
from rtdenoise.data.layout import OWN
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.frame import OFF_SCREEN
from rtdenoise.ops import warp
from rtdenoise.run.denoise import denoise
from rtdenoise.run.describe import describe
from rtdenoise.run.inspect import choose_pairs, inspect
from rtdenoise.run.inspect_text import next_step, render_text
from rtdenoise.run.normals import ENCODED, IN_CAMERA
from rtdenoise.run.options import Options
from rtdenoise.run.readings import READINGS, Reading
from rtdenoise.run.unmoved import STOPPED, Watch

CYCLES = Path(__file__).parent / "data" / "cycles"

H, W, FRAMES = 72, 110, 4


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """The pictures are tiny: on a busy machine several threads wait for each other ten times as long as they work."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def texture(x, y):
    """A smooth pattern on the plane, [..., 3] in [0, 1]."""
    phases = np.arange(3) * 2.1
    waves = np.sin(x[..., None] * 0.31 + phases) * np.cos(y[..., None] * 0.37 - phases) + np.sin(
        (x + 2 * y)[..., None] * 0.11
    )
    return 0.5 + 0.25 * waves


def cameras(kind):
    """2×3 matrices from pixel to plane, of frames -1 … FRAMES."""
    matrices = []
    for number in range(-1, FRAMES + 1):
        angle, zoom, shift = 0.0, 1.0, (0.0, 0.0)
        if kind == "moving":
            angle, zoom, shift = 0.02 * number, 1 + 0.01 * number, (1.3 * number + 0.2 * number**2, -2.1 * number)
        elif kind == "horizontal":
            shift = (1.7 * number, 0.0)
        c, s = zoom * np.cos(angle), zoom * np.sin(angle)
        matrices.append(np.array([[c, -s, shift[0]], [s, c, shift[1]]]))
    return matrices


def frames(kind="moving", noise=0.0):
    """Layers of each frame; motion is exact and in this project's convention."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:H, :W] + 0.5
    pixels = np.stack([x, y], -1)
    matrices = cameras(kind)
    made = []
    for k in range(1, FRAMES + 1):
        plane = pixels @ matrices[k][:, :2].T + matrices[k][:, 2]
        before, after = (
            (plane - m[:, 2]) @ np.linalg.inv(m[:, :2]).T - pixels for m in (matrices[k - 1], matrices[k + 1])
        )
        albedo = texture(plane[..., 0], plane[..., 1])
        color = 3 * albedo * (1 + noise * (rng.exponential(size=(H, W, 1)) - 1))
        made.append({"color": color, "albedo": albedo, "normal": np.broadcast_to([0.0, 0, 1], (H, W, 3)),
                     "depth": np.ones((H, W, 1)), "motion": before, "motion_next": after})  # fmt: skip
    return made


def write(folder, layers_of_frames, change=lambda layers: layers):
    for number, layers in enumerate(layers_of_frames, start=1):
        write_layers(folder / f"{number:03d}.exr", change(layers))
    return folder


def verdict_on(folder, change, kind="moving", **options):
    return inspect(write(folder, frames(kind, **options), lambda layers: {**layers, **change(layers)})).convention


def test_the_synthetic_motion_is_right():
    made = frames()
    as_tensor = [torch.from_numpy(np.ascontiguousarray(f["albedo"])).permute(2, 0, 1)[None] for f in made]
    motion = torch.from_numpy(made[2]["motion"]).permute(2, 0, 1)[None]
    error = (warp(as_tensor[1], motion) - as_tensor[2])[..., 12:-12, 12:-12].abs()
    assert error.max() < 0.02


# --- the convention check ---------------------------------------------------------------------------------------------


def scaled(field, *factors):
    return {"motion": field * np.array(factors)}


WRONG = {  # how the file is wrong -> (what is written as motion, the reading that is to be found, words of the message)
    "negated": (lambda f: scaled(f["motion"], -1, -1), Reading(signs=(-1, -1)), "current - previous: negate it"),
    "y up": (lambda f: scaled(f["motion"], 1, -1), Reading(signs=(1, -1)), "y up: flip y"),
    "negated, y up": (lambda f: scaled(f["motion"], -1, 1), Reading(signs=(-1, 1)), "flip x [motion = (-X, Y)]"),
    "row, column": (lambda f: {"motion": f["motion"][..., ::-1]}, Reading(swapped=True), "swap the components"),
    "UV": (lambda f: scaled(f["motion"], 1 / W, 1 / H), Reading(unit="UV"), "UV units: multiply by (W, H)"),
    "UV, negated": (lambda f: scaled(f["motion"], -1 / W, -1 / H), Reading(unit="UV", signs=(-1, -1)), "(-W·X, -H·Y)"),
    "NDC, y up": (lambda f: scaled(f["motion"], 2 / W, -2 / H), Reading(unit="NDC", signs=(1, -1)), "(W/2·X, -H/2·Y)"),
    "of twice the size": (lambda f: scaled(f["motion"], 2, 2), Reading(unit="double"), "multiply by ½ [motion = (½·X"),
    "of half the size": (lambda f: scaled(f["motion"], 0.5, 0.5), Reading(unit="half"), "half as large: multiply by 2"),
    "layers swapped": (
        lambda f: {"motion": f["motion_next"], "motion_next": f["motion"]},
        Reading(source="motion_next"),
        "the content of motion_next: read that layer [motion = motion_next (X, Y)]",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_convention_is_named(tmp_path, name):
    change, reading, words = WRONG[name]
    verdict = verdict_on(tmp_path, change)
    assert (verdict.status, verdict.best) == ("wrong", reading)
    assert words in verdict.message and "\n" not in verdict.message
    assert verdict.errors["best"] < 0.5 * verdict.errors["declared"]


def test_the_right_convention_is_ok(tmp_path):
    verdict = verdict_on(tmp_path, lambda f: {})
    assert (verdict.status, verdict.best, verdict.feature) == ("ok", Reading(), "albedo")
    assert verdict.tied == () and verdict.pixels > 1000


@pytest.mark.parametrize(("name", "status"), [("right", "ok"), ("negated", "wrong"), ("UV", "wrong")])
def test_noisy_radiance_alone_is_enough(tmp_path, name, status):
    change = WRONG[name][0] if name in WRONG else lambda f: {}
    made = [{k: v for k, v in f.items() if k != "albedo"} for f in frames(noise=1.0)]
    verdict = inspect(write(tmp_path, made, lambda f: {**f, **change(f)})).convention
    assert (verdict.status, verdict.feature) == (status, "radiance")


def curved(f, degrees=0.0):
    """Normals of hills, seen as a frame's albedo is, turned round y."""
    a, b = 2 * f["albedo"][..., 0] - 1, 2 * f["albedo"][..., 1] - 1
    n = np.stack([a, b, np.ones_like(a)], -1)
    n = n / np.linalg.norm(n, axis=-1, keepdims=True)
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return n @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])


@pytest.mark.parametrize("degrees", [0.0, 1.0, 3.0])
def test_normals_in_the_cameras_space_turn_with_it(tmp_path, degrees):
    made = [{**f, "normal": curved(f, degrees * k)} for k, f in enumerate(frames())]
    made[2]["normal"][:20] = 0, 0, -1  # something else is seen there
    found = inspect(write(tmp_path, made))
    assert found.normals == (IN_CAMERA.format(degrees) if degrees else "")
    assert ("  normals      those of the same surfaces turn by" in render_text(found)) == bool(degrees)


def test_a_thing_that_turns_is_no_camera(tmp_path):
    made = frames()
    for k, f in enumerate(made):
        f["normal"] = curved(f)
        f["normal"][:30] = curved(f, 5 * k)[:30]
    assert inspect(write(tmp_path, made)).normals == ""


def test_frames_that_are_all_before_0_may_be_in_the_wrong_order(tmp_path):
    for file in list(write(tmp_path, frames()).iterdir()):  # from 1 on; the dash separates
        file.rename(tmp_path / f"shot.-{file.name}")
    found = inspect(tmp_path)
    assert found.convention.status == "wrong" and found.numbers == (-FRAMES, -1)
    assert "so that -4 is the first; if the - before them only separates, time runs backwards" in render_text(found)
    assert next_step(found).startswith("mend the order of the frames or the motion vectors")
    notes = denoise(str(tmp_path), tmp_path / "out", Options(model="fast")).notes
    assert any("so that -4 is the first" in note for note in notes)


def test_flat_normals_say_nothing(tmp_path):
    made = [{**f, "normal": np.broadcast_to(curved(f, 3 * k)[:1, :1], (H, W, 3))} for k, f in enumerate(frames())]
    assert inspect(write(tmp_path, made)).normals == ""


def test_normals_that_are_stored_as_colours_are_told(tmp_path):
    made = frames()
    for f in made:
        f["normal"] = 0.5 + 0.5 * curved(f)
        f["normal"][:40] = 0  # nothing was hit
    found = inspect(write(tmp_path, made))
    assert found.normals == ENCODED and f"  normals      {ENCODED}" in render_text(found)
    assert next_step(found) == (
        f"rtdenoise inspect {tmp_path} --write my.toml, which describes normals as they are stored"
    )
    layout, notes = describe(tmp_path)
    assert notes["normal"].startswith("measured: stored as n / 2 + 1/2")
    assert inspect(tmp_path, preset=layout).normals == ""


@pytest.mark.parametrize(("stopped", "told"), [(FRAMES, True), (1, False), (0, False)])
def test_motion_next_of_zeros_is_told(tmp_path, capsys, stopped, told):
    """In the last frame, where movement ends, it is right."""
    made = frames()
    for f in made[FRAMES - stopped :]:
        f["motion_next"] = 0 * f["motion"]
    (tmp_path / "shot").mkdir()
    shot = write(tmp_path / "shot", made)
    found = inspect(shot)
    assert (STOPPED in render_text(found)) == ("which leaves out motion_next" in next_step(found)) == told
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", "fast", "--lookahead", "0"])
    assert (STOPPED in capsys.readouterr().out) == told
    if told:
        assert "motion_next" not in describe(shot)[0].layers


def test_nothing_moves(tmp_path):
    verdict = verdict_on(tmp_path, lambda f: {}, kind="static")
    assert verdict.status == "ambiguous" and verdict.best is None
    assert verdict.message == "too little moves: 0 textured pixels move more than 0.25 px, 200 are needed"


def test_nothing_has_texture(tmp_path):
    flat = {"albedo": np.full((H, W, 3), 0.5), "color": np.ones((H, W, 3))}
    verdict = verdict_on(tmp_path, lambda f: flat)
    assert verdict.status == "ambiguous" and "0 textured pixels" in verdict.message


def test_motion_that_explains_nothing(tmp_path):
    verdict = verdict_on(tmp_path, lambda f: {"motion": f["motion"] + 2.5}, kind="static")
    assert verdict.status == "ambiguous"
    found = inspect(tmp_path)
    assert "shifts by (+2.5, +2.5) px a frame against its motion vectors" in render_text(found)
    assert next_step(found) == f"rtdenoise denoise {tmp_path} --out clean/ --lens"
    assert next_step(replace(found, drifts=())).startswith("look at the motion vectors first")
    assert verdict.message == "no reading of the motion explains how albedo changes any better than no motion at all"


def test_noise_explains_nothing(tmp_path):
    """Interpolation averages noise, so pure noise looks better with any motion than without: no proof."""
    rng = np.random.default_rng(3)
    verdict = verdict_on(tmp_path, lambda f: {"albedo": rng.random((H, W, 3)), "color": rng.random((H, W, 3))})
    assert verdict.status == "ambiguous" and verdict.best is None


def test_horizontal_motion_cannot_tell_which_way_is_up(tmp_path):
    verdict = verdict_on(tmp_path, lambda f: {}, kind="horizontal")
    assert verdict.status == "ok" and Reading(signs=(1, -1)) in verdict.tied
    assert all(r.signs[0] == (1 if r.source == "motion" else -1) and not r.swapped for r in verdict.tied)
    assert "not to be told apart here: motion = (X, -Y)" in verdict.message


def test_horizontal_motion_still_tells_its_sign(tmp_path):
    verdict = verdict_on(tmp_path, lambda f: scaled(f["motion"], -1, -1), kind="horizontal")
    assert verdict.status == "wrong" and verdict.best.signs[0] == -1
    assert {"motion = (-X, Y)", "motion = (-X, -Y)"} == {
        r.formula for r in (verdict.best, *verdict.tied) if r.source == "motion"
    }


def test_a_repeating_pattern_is_ambiguous(tmp_path):
    """Stripes that move by half their period look the same with either sign."""
    made = frames("static")
    x = np.mgrid[:H, :W][1]
    for number, layers in enumerate(made):
        stripes = 0.5 + 0.5 * np.sin((x + 8 * number) * np.pi / 8)
        layers["albedo"] = layers["color"] = np.repeat(stripes[:, :, None], 3, 2)
        layers["motion"] = np.broadcast_to([8.0, 0.0], (H, W, 2))
    verdict = inspect(write(tmp_path, made)).convention
    assert verdict.status == "ambiguous"
    assert (
        "as declared fits, but as well does: " in verdict.message and "current - previous: negate it" in verdict.message
    )


def test_readings_undo_what_they_name():
    """Applied to wrongly written motion, a reading gives this project's motion back."""
    rng = np.random.default_rng(0)
    right = rng.normal(size=(H, W, 2))
    for name, (change, reading, _) in WRONG.items():
        fields = change({"motion": right, "motion_next": rng.normal(size=(H, W, 2))})

        stored = torch.from_numpy(np.ascontiguousarray(fields[reading.source]))
        np.testing.assert_allclose(reading.apply(stored, (H, W)), right, atol=1e-6, err_msg=name)
    assert len({reading.formula for reading in READINGS}) == len(READINGS) == 56


# --- facts ------------------------------------------------------------------------------------------------------------


def test_the_facts(tmp_path):
    made = frames()
    made[1]["color"][3, 4] = np.nan
    made[2]["motion"] = made[2]["motion"].copy()
    made[2]["motion"][0, :5] = np.inf
    for layers in made:
        layers["extra"] = np.ones((H, W, 1))
        del layers["normal"]
    write(tmp_path, made)
    (tmp_path / "004.exr").rename(tmp_path / "006.exr")
    with pytest.raises(InputError, match="missing: 4 to 5"):
        inspect(tmp_path)
    found = inspect(tmp_path, allow_gaps=True)
    assert (found.files, found.numbers, found.gaps, found.size) == (4, (1, 6), ((4, 5),), (H, W))
    assert (found.preset, found.signal, found.demodulated, found.scene) == ("native", "color", False, False)
    assert {layer.name: layer.dtype for layer in found.layers} == {
        "radiance": "half", "albedo": "half", "depth": "float", "motion": "float", "motion_next": "float"
    }  # fmt: skip
    assert found.missing == {"normal": f"write it as normal.X, normal.Y, normal.Z, or name it in {OWN}"}
    assert found.ignored == ("extra.V",) and found.computed == ()
    assert found.examined == (1, 2, 3)  # 6 has no neighbour
    assert found.faults == {"radiance: NaN or Inf": 1, "motion: NaN or Inf": 5}
    assert found.convention.status == "ok"
    json.dumps(asdict(found))

    text = render_text(found)
    assert "4 files, 110×72, numbers 1 to 6; 2 missing: 4 to 5" in text and "native; signal color" in text
    assert (
        "radiance: NaN or Inf (1), motion: NaN or Inf (5)" in text
        and "extra.V" in text
        and "write it as normal.X" in text
    )
    assert "OK: previous - current, pixels, y down" in text and "albedo.R, albedo.G" in text
    assert next_step(found).startswith("add normal: write it as normal.X, normal.Y, normal.Z")


def test_names_of_folders_are_printed_as_they_are(tmp_path):
    found = inspect(write_sequence(tmp_path / "shot [final] :cat:", make_frames(2)))
    assert render_text(found).startswith(f"{tmp_path / 'shot [final] :cat:'}\n")


def test_what_denoise_mends_layers_by_is_used():
    """A file that Blender wrote: alpha is denoised, the depth of paths tells of mirrors, the sky of fog."""
    ignored = inspect(CYCLES).ignored
    assert "ViewLayer.Glossy Direct.R" in ignored
    assert not {"ViewLayer.Combined.A", "ViewLayer.Denoising Depth.Z"} & {*ignored}


def test_what_nothing_spares_is_told_when_asked(tmp_path):
    found = inspect(write_sequence(tmp_path / "shot", make_frames(3)))
    assert "warp of history: 0 of 2 frames" in render_text(found, verbose=True)
    assert "0 of" not in render_text(found) and "never" not in render_text(found)


def test_the_next_step_is_a_command_that_works(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_sequence(tmp_path / "my shot", make_frames(3))
    (tmp_path / "my shot" / "frame.0001.exr").unlink()
    main(["inspect", "my shot", "--signal", "indirect", "--allow-gaps"])
    command = capsys.readouterr().out.splitlines()[-1]
    assert command == "next: rtdenoise denoise 'my shot' --out clean/ --signal indirect --allow-gaps"
    main(shlex.split(command)[2:])
    assert (tmp_path / "clean" / "frame.0002.exr").is_file()


def test_wrong_motion_comes_first(tmp_path):
    frames = [replace(frame, motion=-frame.motion) for frame in make_frames(4, H=64, W=64, noise=0)]
    found = inspect(write_sequence(tmp_path / "shot", frames))
    assert found.convention.status == "wrong" and next_step(found).startswith("mend the motion vectors")


@pytest.mark.parametrize("name", [None, "negated", "y up", "UV"])
def test_denoise_tells_of_wrong_motion(tmp_path, capsys, name):
    change = WRONG[name][0] if name else lambda layers: {}
    (tmp_path / "shot").mkdir()
    shot = write(tmp_path / "shot", frames(), lambda layers: {**layers, **change(layers)})
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", "fast"])
    told = [line for line in capsys.readouterr().out.splitlines() if "history comes from wrong places" in line]
    assert len(told) == (name is not None) and all(WRONG[name][2] in line for line in told)


@pytest.mark.parametrize("source", ["samples/mural", "samples/mural-window", "tests/data/cycles"])
def test_right_motion_is_not_called_wrong(source):
    signal = "color" if source.endswith("mural") else "indirect"
    notes, sequence = [], open_sequence(Path(__file__).parents[1] / source, signal=signal)
    read = [sequence.read(i) for i in range(len(sequence))]
    for start in range(len(read) - 2):
        watch = Watch(notes)
        for i, frame in enumerate(read[start : start + 3]):
            watch.see(frame, i > 0)
    assert notes == []


@pytest.mark.parametrize("options", [Options(), Options(lookahead=1), Options(offline=True)],
                         ids=["auto", "ahead", "offline"])  # fmt: skip
def test_what_was_noted_of_the_frames_stays(tmp_path, options):
    """In a run that goes on, in one that was finished, and in denoise.json: what is seen on the way, and of all frames
    at the end."""
    made = make_frames(4)
    zeros, grey = torch.zeros_like(made[0].motion), torch.full_like(made[0].albedo, 0.5)
    still = [replace(frame, motion=zeros, motion_next=None, albedo=grey) for frame in made]
    shot, out = write_sequence(tmp_path / "shot", still), tmp_path / "out"
    options = replace(options, model="fast", detect_cuts=False, shutter=0.7)

    def stop(done, total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        denoise(str(shot), out, options, on_frame=stop)
    first = denoise(str(shot), out, options)
    once = denoise(str(shot), tmp_path / "once", options)
    for notes in (first.notes, once.notes):
        assert sum("motion is zero everywhere" in note for note in notes) == 1
        assert any(note.startswith("--shutter") for note in notes)
    assert any("albedo is the same" in note for note in once.notes)
    for folder, before in ((out, first), (tmp_path / "once", once)):
        assert json.loads((folder / "denoise.json").read_text())["notes"] == before.notes
        assert denoise(str(shot), folder, options).notes == before.notes
        assert json.loads((folder / "denoise.json").read_text())["notes"] == before.notes


@pytest.mark.parametrize(("moves", "options"), [
    (True, ()), (True, ("--lookahead", "1")), (True, ("--offline",)), (False, ()),
])  # fmt: skip
def test_motion_of_zeros_in_a_picture_that_changes_is_told_once(tmp_path, capsys, moves, options):
    """As Blender 4 writes it with motion blur; where nothing moves it is right."""
    zeros = torch.zeros_like(make_frames(1)[0].motion)
    made = make_frames(3) if moves else [replace(make_frames(1)[0], number=number) for number in range(3)]
    shot = write_sequence(tmp_path / "shot", [replace(frame, motion=zeros, motion_next=zeros) for frame in made])
    found, words = inspect(shot), "motion is zero everywhere though the picture changes"
    assert found.unmoved == ((1, 2) if moves else ()) and (words in render_text(found)) == moves
    assert next_step(found).startswith("render again without motion blur" if moves else "rtdenoise denoise")
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", "fast", *options])
    assert capsys.readouterr().out.count(words) == moves


def test_smoke_before_nothing_has_no_motion(tmp_path):
    """Nor a surface, though its albedo is another in each frame."""
    zeros = torch.zeros_like(make_frames(1)[0].motion)
    made = [replace(f, motion=zeros, motion_next=zeros, depth=0 * f.depth, albedo=torch.rand_like(f.albedo))
            for f in make_frames(3)]  # fmt: skip
    found = inspect(write_sequence(tmp_path / "shot", made))
    assert found.unmoved == () and next_step(found).startswith("rtdenoise denoise")


def test_of_large_frames_fewer_are_in_memory_at_once():
    numbers = tuple(range(24))
    counts = [len(choose_pairs(numbers, size)) for size in ((180, 320), (1080, 1920), (1440, 2560), (4320, 7680))]
    assert counts == [6, 6, 3, 2] and choose_pairs(numbers, (2160, 3840)) == [(0, 1), (22, 23)]
    assert choose_pairs((1,), (4320, 7680)) == [] and choose_pairs((1, 2, 4), (4320, 7680)) == [(0, 1)]


def test_a_pause_does_not_hide_that_motion_is_zero(tmp_path):
    """Of a long sequence six pairs of frames are compared; in the last one nothing changes."""
    zeros = torch.zeros_like(make_frames(1)[0].motion)
    made = [replace(frame, motion=zeros, motion_next=zeros) for frame in make_frames(2)]
    made = [replace(made[k % 2 if k < 23 else 0], number=k) for k in range(24)]
    found = inspect(write_sequence(tmp_path / "shot", made))
    assert len(found.unmoved) == found.pairs - 1 == 5
    assert next_step(found).startswith("render again without motion blur")


@pytest.mark.parametrize("constant", [True, False])
def test_an_albedo_that_tells_nothing_is_told(tmp_path, capsys, constant):
    """In the first two frames, or in all."""
    made = [replace(frame, albedo=torch.full_like(frame.albedo, 0.5)) for frame in make_frames(3)]
    shot = write_sequence(tmp_path / "shot", made if constant else [*made[:2], make_frames(3)[2]])
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", "fast"])
    assert ("albedo is the same in all pixels of all frames" in capsys.readouterr().out) == constant
    main(["inspect", str(shot)])
    assert ("albedo       is the same in all pixels of the frames examined" in capsys.readouterr().out) == constant


@pytest.mark.parametrize("rest", ["albedo", "motion_next", "motion"])
def test_of_frames_that_an_earlier_run_saw_nothing_is_told(tmp_path, capsys, rest):
    """Only those that are appended have one albedo, no `motion_next` or, after many cuts, no motion."""
    made, flat = make_frames(5), torch.full_like(make_frames(1)[0].albedo, 0.5)
    for i, frame in enumerate(made):
        if rest == "motion":  # other surfaces in each frame
            made[i] = replace(frame, depth=frame.depth * 3 ** (i % 4), motion=frame.motion * (i < 3))
        elif i > 2:
            made[i] = replace(frame, **{rest: flat if rest == "albedo" else 0 * frame.motion})
    out, options = tmp_path / "out", ("--model", "fast", "--lookahead", "0")
    for part in (made[:3], made[3:]):
        shot = write_sequence(tmp_path / "shot", part)
        main(["denoise", str(shot), "--out", str(out), *options])
        told = capsys.readouterr().out
    assert "albedo is the same" not in told and STOPPED not in told and "motion is zero" not in told
    assert json.loads((out / "denoise.json").read_text())["skipped"] == 3


def test_a_cut_between_still_shots_is_no_motion(tmp_path, capsys):
    first, last = make_frames(1)[0], make_frames(1)[0]
    last = replace(last, depth=last.depth * 3)
    shot = write_sequence(tmp_path / "shot", [
        replace(frame, number=i, motion=torch.zeros_like(frame.motion), motion_next=torch.zeros_like(frame.motion))
        for i, frame in enumerate([first, first, first, last, last])
    ])  # fmt: skip
    assert next_step(inspect(shot)).startswith("rtdenoise denoise")
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", "fast"])
    assert "motion is zero" not in capsys.readouterr().out


def test_a_sky_of_unknown_motion_is_no_evidence(tmp_path):
    """The camera pans: a sky without vectors shows nothing of up and down, and its edges look moved by any reading."""
    made = frames("horizontal")
    for layers in made:
        sky = np.arange(H)[:, None] + 8 * np.sin(np.arange(W) / 5) < H / 2
        layers["albedo"] = np.where(sky[..., None], 0.0, layers["albedo"])
        layers["depth"] = np.where(sky[..., None], 0.0, layers["depth"])
        for name in ("motion", "motion_next"):
            layers[name] = np.where(sky[..., None], OFF_SCREEN, layers[name])
    found = inspect(write(tmp_path, made))
    assert found.convention.status == "ok", found.convention.message
    assert found.motion.unknown > 0.3 and found.motion.max < 3 and found.motion.off_screen < 0.1
    assert "unknown in" in render_text(found)


def test_motion_statistics(tmp_path):
    """Every pixel but the left tenth comes from 3 px to the right and 4 px below; a box hides a part of that."""
    motion = np.broadcast_to([3.0, 4.0], (H, W, 2)).copy()
    motion[:, :11] = 0
    motion_next = -motion
    motion_next[40:50, 40:60] = [7.0, -4.0]
    layers = {"color": np.ones((H, W, 3)), "motion": motion, "motion_next": motion_next}
    found = inspect(write(tmp_path, [layers] * 3)).motion
    assert found.mean == pytest.approx(4.5) and (found.p50, found.p99, found.max) == (5.0, 5.0, 5.0)
    assert found.still == pytest.approx(0.1)
    assert found.off_screen == pytest.approx(1 - (W - 3 - 11) * (H - 4) / (W * H) - 11 / W)
    assert found.uncovered == pytest.approx((10 * 20 + 3 * H - 3 * 4) / (W * H), abs=0.03)


def test_says_where_dual_motion_comes_from(tmp_path):
    layers = {"color": np.ones((H, W, 3)), "motion": np.zeros((H, W, 2)), "depth": np.ones((H, W, 1))}
    for name in ("both", "backward", "flat"):
        (tmp_path / name).mkdir()
    both = inspect(write(tmp_path / "both", [layers | {"motion_next": np.zeros((H, W, 2))}] * 2))
    assert both.dual_motion == "exact, from motion_next"
    backward = inspect(write(tmp_path / "backward", [layers] * 2))
    assert backward.dual_motion.startswith("approximate: motion_next is missing") and backward.motion.uncovered == 0
    assert "dual motion  approximate" in render_text(backward)
    del layers["depth"]
    flat = inspect(write(tmp_path / "flat", [layers] * 2))
    assert flat.dual_motion.startswith("none: without motion_next and depth") and flat.motion.uncovered is None


def test_without_motion(tmp_path):
    write_layers(tmp_path / "1.exr", {"color": np.ones((H, W, 3))})
    found = inspect(tmp_path)
    assert found.motion is None and found.convention is None and found.examined == (1,)
    assert found.dual_motion == "none: there is no motion"
    assert {"motion", "motion_next"} <= found.missing.keys()
    assert "not checked: it takes motion in two consecutive frames" in render_text(found)
