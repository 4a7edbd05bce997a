"""Methods, errors and times of one run, and the files that `rtdenoise evaluate` writes."""

import functools
import json
import math
import shutil
import sys
import webbrowser
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import OpenEXR
import pytest
import torch
from matplotlib.figure import Figure
from rich.console import Console
from synthetic import make_frames, write_sequence

from rtdenoise import metrics
from rtdenoise.cli.main import main
from rtdenoise.color import display_exposure
from rtdenoise.errors import InputError
from rtdenoise.evaluate import ALL_METRICS, ALL_REGIONS, choose, evaluate, methods, uncovered
from rtdenoise.evaluate.document import Document
from rtdenoise.evaluate.inputs import Source, reference_errors
from rtdenoise.evaluate.options import NEEDS, EvaluateOptions
from rtdenoise.evaluate.origin import commit
from rtdenoise.evaluate.registry import DEFAULTS
from rtdenoise.evaluate.run import run
from rtdenoise.files import lock
from rtdenoise.models import CombinerConfig, available, create, find, load, save
from rtdenoise.models.weights import bytes_of
from rtdenoise.report import report
from rtdenoise.report.chart import chart, tick_values
from rtdenoise.report.markdown import markdown
from rtdenoise.report.page import page, payload
from rtdenoise.report.summary import summary
from rtdenoise.run.choice import BEST
from rtdenoise.run.options import AHEAD

PLAIN = ("noisy", "accumulate")


@pytest.fixture
def shot(tmp_path):
    """A sequence with references, and its input at 4 spp."""
    folder = write_sequence(tmp_path / "shot", make_frames(4))
    write_sequence(folder / "spp4", make_frames(4, noise=0.5), without=("reference", "reference_half"))
    (folder / "samples.json").write_text('{"sample_ms": 10.0}')
    return folder


def test_what_is_told_of_a_sequence_is_of_its_base_sample_count(shot, tmp_path, monkeypatch):
    """Pictures are of these frames, whatever the frames at more samples uncover."""
    run([str(shot)], tmp_path, EvaluateOptions(("noisy",), metrics=("psnr",)))
    monkeypatch.setattr("rtdenoise.evaluate.run.stills", lambda masks: [3])
    more = run([str(shot)], tmp_path, EvaluateOptions(("noisy",), metrics=("psnr",), spp=(1, 4)))
    (facts,) = more.sequences.values()
    assert len(more.results) == 2
    assert all((tmp_path / "pictures" / shot.name / f"{still:04d}").is_dir() for still in facts["stills"])


def test_shipped_weights_are_methods_and_what_is_left_of_them():
    known = methods()
    for name in available():
        assert {name, f"{name}-traditional", f"{name}-spatial"} <= known.keys()
        assert not known[name].unavailable() and not known[name].unavailable("bf16")
    assert known["svgf"].unavailable("bf16") == "has no bf16 version"


def test_weights_that_ship_later_are_found(monkeypatch):
    monkeypatch.setattr("rtdenoise.evaluate.registry.available", lambda: ["default", "later", "paper"])
    monkeypatch.setattr("rtdenoise.evaluate.registry.find", Path)
    known = methods()
    assert known["later"].family == "network" and known["later-spatial"].family == "ablation"


def test_weights_of_ones_own_are_measured_under_their_name(tmp_path):
    mine = tmp_path / "weights.safetensors"
    shutil.copy(find("fast"), mine)
    shutil.copy(bytes_of(find("fast")), bytes_of(mine))
    ours, theirs = evaluate(make_frames(2, H=32, W=32), [f"mine={mine}", "fast", f"mine={mine}"])
    assert (ours.method, theirs.method) == ("mine", "fast") and torch.equal(ours.images[1], theirs.images[1])


def test_a_corrected_method_has_the_weights_of_both_networks(tmp_path):
    assert [choose([name])[0].weights for name in ("default+shrinkage", "svgf+shrinkage")] == [("default",), ()]
    save(create(CombinerConfig(widths=(4, 4, 4), scales=2, kernel=3)), tmp_path / "small.safetensors")
    mine = str(tmp_path / "small.safetensors")
    assert choose([f"fast+{mine}"])[0].weights == ("fast", mine)


def test_weights_that_changed_are_measured_again(shot, tmp_path):
    mine, out = tmp_path / "weights.safetensors", tmp_path / "out"
    for weights in ("fast", "paper"):
        shutil.copy(find(weights), mine)
        document = run([str(shot)], out, EvaluateOptions((f"mine={mine}", weights)))
        (ours,) = (r["errors"] for r in document.results if r["method"] == "mine")
        (theirs,) = (r["errors"] for r in document.results if r["method"] == weights)
        assert ours == theirs


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (["magic"], "unknown method 'magic'; expected NAME=FILE of weights, or some of noisy, accumulate"),
        (["mine=nowhere.safetensors"], "mine=nowhere.safetensors: no such weights file"),
        (["../mine={file}"], "expected a name of letters"),
        (["={file}"], "expected a name of letters"),
        (["reference={file}"], "and not 'reference'"),
        (["paper={file}"], "another method is called 'paper'"),
        (["a={file}", "a={copy}"], "another method is called 'a'"),
        (["oidn+shrinkge"], r"no model 'shrinkge' \(did you mean 'shrinkage'\?\): expected one of shrinkage, combiner"),
        (["oidn+dc:nowhere.safetensors"], "no model 'nowhere.safetensors': expected one of shrinkage"),
    ],
)
def test_what_cannot_be_a_method(asked, message, tmp_path):
    files = {"file": find("fast"), "copy": tmp_path / "copy.safetensors"}
    shutil.copy(*files.values())
    with pytest.raises(InputError, match=message):
        evaluate(make_frames(2), [name.format(**files) for name in asked])


def test_a_method_that_is_not_there_says_why(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    for name in ("oidn", "offline"):  # and that is not measured without OIDN under its name
        with pytest.raises(InputError, match=f"{name}: needs pyoidn: pip install"):
            methods()[name].step()
    assert not methods()["offline-without-oidn"].unavailable()


def test_the_spatial_network_has_no_history():
    frames = make_frames(3)
    spatial = evaluate(frames, ["paper-spatial"])[0].images[2]
    torch.testing.assert_close(spatial, load("paper").step(frames[2])[0])


def test_bf16_is_near_fp32_and_not_the_same():
    frames = make_frames(3)
    images = {}
    for precision in ("fp32", "bf16"):
        step, history = methods()["paper"].step(precision=precision), None
        with torch.inference_mode():
            for frame in frames:
                images[precision], history = step(frame, history)
    assert images["bf16"].dtype == torch.float32
    difference = (images["bf16"] - images["fp32"]).abs().mean() / images["fp32"].mean()
    assert 0 < difference < 0.02


def test_errors_are_those_of_the_metrics():
    frames = make_frames(4)
    steps = {"half": lambda frame, history: (frame.reference * 0.5 + frame.radiance * 0.5, None)}
    (result,) = evaluate(frames, steps, metrics=ALL_METRICS, regions=ALL_REGIONS)
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    images, masks = [steps["half"](frame, None)[0] for frame in frames], uncovered(frames)
    assert [row["number"] for row in result.frames] == [1, 2, 3] and len(result.times) == 3
    for row, i in zip(result.frames, (1, 2, 3), strict=True):
        now, pair = (
            (images[i], frames[i].reference),
            (tuple(images[i - 1 : i + 1]), (frames[i - 1].reference, frames[i].reference)),
        )
        assert row["frame"]["psnr"] == metrics.psnr(*now, scale)
        assert row["uncovered"]["flip"] == pytest.approx(metrics.flip(*now, scale, masks[i]))
        before = metrics.smape(*now, scale, metrics.recent_masks(masks, i)[1])
        assert row["uncovered-1"]["smape"] == pytest.approx(before, nan_ok=True)
        assert row["frame"]["tpsnr"] == metrics.tpsnr(*pair, scale)
    assert result.frames[1]["uncovered-1"]["smape"] > 0
    assert result.errors["frame"]["mse"] == pytest.approx(sum(row["frame"]["mse"] for row in result.frames) / 3)


def with_noisy_references(frames, noise=0.05):
    g = torch.Generator().manual_seed(2)
    halves = [[f.reference * (1 + noise * torch.randn(f.reference.shape, generator=g)) for f in frames] for _ in "12"]
    return [replace(f, reference=(a + b) / 2, reference_half=a) for f, a, b in zip(frames, *halves, strict=True)]


def test_corrected_psnr_is_of_the_mean_over_frames():
    truth = make_frames(5, H=48, W=64)
    frames = with_noisy_references(truth)
    steps = {"half": lambda frame, history: (truth[frame.number].reference * 1.02, None)}
    (result,) = evaluate(frames, steps, metrics=("psnr_corrected", "psnr"), regions=("frame", "uncovered"))
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    expected = [
        metrics.mse_corrected(
            truth[i].reference * 1.02, frames[i].reference, scale, reference_half=frames[i].reference_half
        )
        for i in range(1, 5)
    ]
    true = sum(metrics.mse(f.reference * 1.02, f.reference, scale) for f in truth[1:]) / 4
    found = result.errors["frame"]["psnr_corrected"]
    assert found == pytest.approx(-10 * math.log10(sum(expected) / 4))
    assert found == pytest.approx(-10 * math.log10(true), abs=0.3) and found > result.errors["frame"]["psnr"] + 3
    assert set(result.errors["frame"]) == {"psnr", "psnr_corrected"}
    # Inside the few uncovered pixels single frames can be negative; their mean counts.
    (result,) = evaluate(frames, steps, metrics=("mse_corrected", "psnr_corrected"), regions=("uncovered",))
    errors = result.errors["uncovered"]
    assert errors["psnr_corrected"] == pytest.approx(-10 * math.log10(errors["mse_corrected"]))


def test_errors_over_time_begin_at_the_second_frame():
    frames = with_noisy_references(make_frames(3, H=48, W=64))
    over_time = ("tpsnr", "tpsnr_corrected", "tmse_corrected", "temporal_relmae")
    whole, later = (evaluate(frames, ["noisy"], skip, (*over_time, "psnr"))[0] for skip in (0, 1))
    assert (len(whole.frames), len(later.frames)) == (3, 2)
    for metric in over_time:
        assert math.isnan(whole.frames[0]["frame"][metric])
        assert whole.errors["frame"][metric] == later.errors["frame"][metric]
    assert whole.errors["frame"]["psnr"] != later.errors["frame"]["psnr"]


def test_without_half_references_nothing_is_corrected(tmp_path, capsys):
    bare = [replace(frame, reference_half=None) for frame in make_frames(3)]
    (result,) = evaluate(bare, ["noisy"], metrics=("psnr_corrected", "mse_corrected", "psnr"))
    errors = result.errors["frame"]
    assert math.isnan(errors["psnr_corrected"]) and math.isnan(errors["mse_corrected"]) and errors["psnr"] > 0
    shot = write_sequence(tmp_path / "shot", make_frames(3), without=("reference_half",))
    main(["evaluate", str(shot), "--out", str(tmp_path / "out"), "--methods", "noisy"])
    assert "shot, 1 spp: no half references" in capsys.readouterr().out
    document = Document.read(tmp_path / "out")
    assert document.results[0]["errors"]["frame"]["psnr_corrected"] is None
    assert document.sequences["shot"]["reference_psnr"] is None


def test_it_ends_with_a_table_of_what_was_measured(shot, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "200")
    main(["evaluate", str(shot), "--out", str(tmp_path), "--methods", "noisy", "--metrics", "psnr", "ssim"])
    (row,), told = Document.read(tmp_path).results, capsys.readouterr().out
    (line,) = (line.split() for line in told.splitlines() if line.split()[2:3] == ["noisy"])
    psnr, ssim = ({region: row["errors"][region][m] for region in ("frame", "uncovered")} for m in ("psnr", "ssim"))
    shown = [f"{psnr['frame']:.2f}", f"{psnr['uncovered']:.2f}", f"{ssim['frame']:.3f}"]
    assert line == [shot.name, "1", "noisy", *shown, f"{row['ms']['median']:.0f}"]
    assert "SSIM" in told and "FLIP" not in told and "corrected" not in told


def test_names_of_methods_are_whole_in_80_columns():
    regions = {"psnr_corrected": 31.42, "ssim": 0.871, "relmse": 0.0213, "flip": 0.084}
    row = {"sequence": "kitchen_v012", "spp": 1, "method": "hybrid-large-ahead6", "precision": "fp32",
           "errors": dict.fromkeys(("frame", "uncovered"), regions), "ms": {"median": 1234.5}}  # fmt: skip
    with (console := Console(width=80, markup=False, emoji=False)).capture() as printed:
        console.print(summary([row]))
    text = printed.get()
    assert all(word in text for word in ("hybrid-large-ahead6", "31.42", "0.0213", "0.084", "1234", "kitchen_v012"))


@pytest.mark.parametrize("metric, shown", [
    ("fovvideovdp", "7.42"), ("smape", "7.420"), ("tpsnr", "7.42"), ("mse_corrected", "7.42000"),
])  # fmt: skip
def test_the_table_shows_what_alone_was_measured(metric, shown):
    row = {"sequence": "shot", "spp": 1, "method": "default", "precision": "fp32",
           "errors": {"frame": {metric: 7.42}, "uncovered": {}}, "ms": {"median": 12.0}}  # fmt: skip
    with (console := Console(width=80, markup=False, emoji=False)).capture() as printed:
        console.print(summary([row]))
    assert shown in printed.get().split()


def test_the_table_has_names_of_folders_as_they_are(tmp_path, capsys):
    shot = write_sequence(tmp_path / "shot[v2]:cat:", make_frames(2))
    main(["evaluate", str(shot), "--out", str(tmp_path / "out"), "--methods", "noisy", "--metrics", "psnr"])
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [row[0] for row in rows if row[2:3] == ["noisy"]] == [shot.name]


def test_metrics_can_be_chosen_and_what_is_missing_is_added(shot, tmp_path, monkeypatch):
    out = tmp_path / "out"
    main(["evaluate", str(shot), "--out", str(out), "--methods", "noisy", "--metrics", "psnr", "ssim"])
    (row,) = Document.read(out).results
    assert set(row["errors"]["uncovered"]) == {"psnr", "ssim"}
    main(["evaluate", str(shot), "--out", str(out), "--methods", "noisy", "--metrics", "psnr", "psnr_corrected"])
    (row,) = Document.read(out).results
    assert set(row["errors"]["frame"]) == {"psnr", "psnr_corrected", "ssim"} and len(row["frames"]) == 3
    assert {"psnr", "psnr_corrected", "ssim"} <= row["frames"][0]["frame"].keys()
    main(["evaluate", str(shot), "--out", str(out), "--methods", *PLAIN, "--metrics", "psnr"])
    kept, added = Document.read(out).results
    assert kept == row and set(added["errors"]["frame"]) == {"psnr"}
    with pytest.raises(InputError, match="unknown metric 'beauty'; expected some of psnr, psnr_corrected"):
        run([str(shot)], out, EvaluateOptions(PLAIN, metrics=("beauty",)))
    monkeypatch.setitem(NEEDS, "fovvideovdp", ("nowhere", "pyfvvdp"))
    with pytest.raises(InputError, match="metric fovvideovdp needs a package that is not there: pip install pyfvvdp"):
        run([str(shot)], out, EvaluateOptions(PLAIN, metrics=("fovvideovdp",)))


def test_what_cannot_be_measured_again_is_kept(shot, tmp_path, monkeypatch):
    run([str(shot)], tmp_path, EvaluateOptions(("svgf",), metrics=("psnr",)))
    told = []
    monkeypatch.setattr("rtdenoise.evaluate.run.Method.unavailable", lambda method, precision: "needs more memory")
    document = run([str(shot)], tmp_path, EvaluateOptions(("svgf",), metrics=("ssim",)), say=told.append)
    assert told[0].endswith("left out: svgf fp32: needs more memory") and not document.skipped
    assert set(document.results[0]["errors"]["frame"]) == {"psnr"}


def test_frames_say_how_many_samples_they_have(shot):
    source = Source.open(shot, "color", "auto", None)
    for spp in (1, 4):
        assert [frame.samples.unique().tolist() for frame in source.frames(spp)] == [[spp]] * 4
    told = [replace(frame, samples=torch.full_like(frame.depth, 7)) for frame in make_frames(2)]
    source = Source.open(write_sequence(shot.parent / "told", told), "color", "auto", None)
    assert [frame.samples.unique().tolist() for frame in source.frames(1)] == [[7]] * 2


def test_frames_have_the_samples_that_they_note(shot, tmp_path, capsys):
    """As those of Cycles do; samples.json counts more."""
    (shot / "samples.json").unlink()
    for file in shot.glob("*.exr"):
        layers = OpenEXR.File(str(file), separate_channels=True)
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        channels = {name: channel.pixels for name, channel in layers.channels().items()}
        OpenEXR.File(header | {"cycles.ViewLayer.samples": "16"}, channels).write(str(file))
    assert Source.open(shot, "color", "auto", None).spp == 16
    out = tmp_path / "out"
    document = run([str(shot)], out, EvaluateOptions(("noisy",), metrics=("psnr",)))
    assert [row["spp"] for row in document.results] == [16]
    with pytest.raises(SystemExit):
        main(["evaluate", str(shot), "--out", str(tmp_path / "none"), "--methods", "noisy", "--spp", "2"])
    told = capsys.readouterr()
    assert "no input at 2 spp" in told.out and "samples.json" in told.out and "nothing was measured" in told.err
    with pytest.raises(SystemExit):
        main(["evaluate", str(shot), "--out", str(tmp_path / "none"), "--methods", "noisy", "fast", "--spp", "2"])
    assert "the networks ran" not in capsys.readouterr().out
    (shot / "samples.json").write_text('{"spp": 2}')
    assert Source.open(shot, "color", "auto", None).spp == 2


def test_what_looks_ahead_goes_without_a_combiner():
    with pytest.raises(InputError, match=r"hybrid-ahead2\+shrinkage: methods that look ahead are measured as they are"):
        choose(("hybrid-ahead2+shrinkage",))


def test_the_quality_of_a_sequence_is_one_number(monkeypatch):
    given = []

    def quality(images, references, scale):
        given.append((len(images), len(references)))
        return 7.5

    monkeypatch.setattr("rtdenoise.metrics.fovvideovdp", quality)
    (result,) = evaluate(make_frames(4), ["noisy"], metrics=("psnr", "fovvideovdp"))
    assert result.errors["frame"]["fovvideovdp"] == 7.5 and math.isnan(result.errors["uncovered"]["fovvideovdp"])
    assert given == [(3, 3)] and "fovvideovdp" not in result.frames[0]["frame"]


def test_both_signals_in_one_run(shot, tmp_path):
    main(["evaluate", str(shot), "--out", str(tmp_path / "out"), "--methods", "noisy", "--signal", "both"])
    assert [Document.read(tmp_path / "out" / s).signal for s in ("color", "indirect")] == ["color", "indirect"]


def test_the_references_own_error_comes_from_their_halves():
    g = torch.Generator().manual_seed(1)
    truth = torch.full((1, 3, 64, 64), 2.0)
    halves = [truth + 0.1 * torch.randn(truth.shape, generator=g) for _ in range(2)]
    frame = make_frames(1, H=64, W=64)[0]
    frame = replace(frame, reference=(halves[0] + halves[1]) / 2, reference_half=halves[0])
    assert reference_errors([frame])["reference_relmse"] == pytest.approx(0.1**2 / 2 / 2**2, rel=0.1)
    own = metrics.mse(frame.reference, truth, display_exposure(frame.reference))
    assert reference_errors([frame])["reference_psnr"] == pytest.approx(-10 * math.log10(own), abs=0.3)
    assert set(reference_errors([replace(frame, reference_half=None)]).values()) == {None}


def test_a_run_measures_and_leaves_out_with_reasons(shot, tmp_path, capsys, monkeypatch):
    out, broken = tmp_path / "out", tmp_path / "broken"
    broken.write_text("no weights")
    command = ["evaluate", str(shot), "--out", str(out), "--methods", *PLAIN, f"it={broken}", "--spp", "1", "4", "8"]
    monkeypatch.setattr("rtdenoise.models.inference.takes_bytes", lambda precision, device: True)
    main([*command, "--device", "cpu"])
    document = Document.read(out)
    assert [(r["spp"], r["method"]) for r in document.results] == [(n, m) for n in (1, 4) for m in PLAIN]
    one, four = (r["errors"]["frame"]["psnr"] for r in document.results if r["method"] == "noisy")
    assert four > one + 3
    reasons = {(row["spp"], row["method"]): row["reason"] for row in document.skipped}
    assert "not a readable safetensors file" in reasons[1, "it"] and "no input at 8 spp" in reasons[8, "noisy"]
    assert document.sequences["shot"]["sample_ms"] == 10 and document.sequences["shot"]["size"] == [24, 32]
    assert {"command", "commit", "devices", "versions"} <= document.runs[0].keys()
    still = out / "pictures" / "shot" / f"{document.sequences['shot']['stills'][0]:04d}"
    assert {path.stem for path in still.glob("*.exr")} == {*PLAIN, "reference"}
    told = capsys.readouterr().out
    assert "no input at 8 spp" in told and "`denoise` runs most in int8 here" in told


def test_where_there_is_no_git_the_commit_is_unknown(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert commit() == "unknown"


def test_two_runs_do_not_measure_into_one_folder(shot, tmp_path):
    (tmp_path / "out").mkdir()
    with lock(tmp_path / "out"), pytest.raises(InputError, match="another run is writing there"):
        run([str(shot)], tmp_path / "out", EvaluateOptions(("noisy",)))
    run([str(shot)], tmp_path / "out", EvaluateOptions(("noisy",)))


def test_what_was_measured_is_not_measured_again(shot, tmp_path, monkeypatch):
    out, asked = tmp_path / "out", []
    run([str(shot)], out, EvaluateOptions(("noisy",)))

    def count(frames, steps, **options):
        asked.append(list(steps))
        return evaluate(frames, steps, **options)

    monkeypatch.setattr("rtdenoise.evaluate.run.evaluate", count)
    run([str(shot)], out, EvaluateOptions(PLAIN))
    assert asked == [["accumulate fp32"]]
    run([str(shot)], out, EvaluateOptions(PLAIN))
    assert len(asked) == 1
    shutil.rmtree(shot)
    write_sequence(shot, make_frames(4, seed=5))
    run([str(shot)], out, EvaluateOptions(PLAIN))
    assert asked[1:] == [["noisy fp32", "accumulate fp32"]]
    assert len(Document.read(out).results) == 2


def test_a_result_stays_where_its_method_is_not_installed_any_more(shot, tmp_path, monkeypatch):
    run([str(shot)], tmp_path / "out", EvaluateOptions(PLAIN))
    monkeypatch.setattr("rtdenoise.evaluate.registry.Method.unavailable", lambda self, precision="auto": "is gone")
    document = run([str(shot)], tmp_path / "out", EvaluateOptions((*PLAIN, "svgf")))
    assert [row["method"] for row in document.results] == list(PLAIN)
    assert [(row["method"], row["reason"]) for row in document.skipped] == [("svgf", "is gone")]


def test_another_layout_of_the_files_is_measured_again(shot, tmp_path):
    """One's own, under the same name."""
    preset = tmp_path / "my.toml"
    layers = {"color": "RGB", "albedo": "RGB", "normal": "XYZ", "depth": "Z", "motion": "XY", "reference": "RGB"}

    def measured(signs):
        lines = ['name = "mine"']
        for layer, components in layers.items():
            prefix = "" if layer == "color" else f"{layer}."
            lines += [f"[{layer}]", f"channels = {[prefix + c for c in components]}"]
            lines += [f"signs = {signs}"] if layer == "motion" else []
        preset.write_text("\n".join(lines))
        options = EvaluateOptions(("accumulate",), metrics=("psnr",), preset=str(preset))
        (row,) = run([str(shot)], tmp_path / "out", options).results
        return row["errors"]["frame"]["psnr"]

    first = measured([1, 1])
    assert measured([-1, -1]) < first and measured([1, 1]) == first


def test_the_time_of_a_sample_may_come_later(shot, tmp_path):
    options = EvaluateOptions(("noisy",), metrics=("psnr",))
    for stored, expected in (("{}", None), ('{"sample_ms": 38.5}', 38.5)):
        (shot / "samples.json").write_text(stored)
        run([str(shot)], tmp_path, options)
        assert Document.read(tmp_path).sequences["shot"]["sample_ms"] == expected


def test_results_of_other_frames_are_told(shot, tmp_path):
    said = []
    run([str(shot)], tmp_path, EvaluateOptions(PLAIN, metrics=("psnr",), frames=2), said.append)
    assert not any("other frames" in line for line in said)
    run([str(shot)], tmp_path, EvaluateOptions(("noisy",), metrics=("psnr",)), said.append)
    assert "shot, 1 spp: results of accumulate are of other frames" in said[-1]
    run([str(shot)], tmp_path, EvaluateOptions(PLAIN, metrics=("psnr",)), said.append)
    assert said[-1] == "shot, 1 spp: 1 method on 4 frames"


def test_a_method_that_cannot_take_the_frames_is_left_out(tmp_path):
    folder = write_sequence(tmp_path / "bare", make_frames(3), without=("albedo",))
    document = run([str(folder)], tmp_path / "out", EvaluateOptions(("accumulate", "svgf")))
    assert [row["method"] for row in document.results] == ["accumulate"]
    assert "layer albedo is missing" in document.skipped[0]["reason"]


def test_bad_requests_are_one_line(shot, tmp_path, capsys):
    out = tmp_path / "out"
    run([str(shot)], out, EvaluateOptions(("noisy",)))
    cases = [
        ([str(shot), "--signal", "indirect"], "holds results of the signal 'color'"),
        ([str(shot), "--precision", "int4"], "unknown precision 'int4'"),
        ([str(shot), str(shot)], "two sequences are called 'shot'"),
        ([str(shot / "spp4")], "reference"),
        ([str(shot), "--spp", "0"], "expected 1 or more, got 0"),
        ([str(shot / "*.exr")], "expected a folder"),
        ([], "no sequence"),
    ]
    for arguments, expected in cases:
        with pytest.raises(SystemExit) as stopped:
            main(["evaluate", *arguments, "--out", str(out), "--methods", "noisy", "--device", "cpu"])
        assert stopped.value.code == 2
        message = capsys.readouterr().err
        assert expected in message and message.count("\n") == 1
    for wrong in ("[3]", '{"spp": 1e400}', '{"spp": 0}', '{"spp": 2.7}', '{"spp": true}', '{"sample_ms": -1}'):
        (shot / "samples.json").write_text(wrong)
        with pytest.raises(InputError, match=r"samples\.json: expected"):
            run([str(shot)], out, EvaluateOptions(("noisy",)))


def test_the_file_is_json_without_nan(shot, tmp_path):
    run([str(shot)], tmp_path, EvaluateOptions(("noisy",)))
    content = json.loads((tmp_path / "evaluation.json").read_text(), parse_constant=pytest.fail)
    assert content["results"][0]["ghost_length"] is None
    (tmp_path / "evaluation.json").write_text('{"format": "other"}')
    with pytest.raises(InputError, match="expected the format"):
        Document.read(tmp_path)


def test_a_folder_of_results_is_told_where_they_are(tmp_path):
    for signal in ("color", "indirect"):
        (tmp_path / signal).mkdir()
        Document(signal).write(tmp_path / signal)
    with pytest.raises(InputError, match=f"not there; choose {tmp_path / 'color'} or {tmp_path / 'indirect'}$"):
        Document.read(tmp_path)


def test_a_single_frame_is_measured_and_drawn(tmp_path):
    still = write_sequence(tmp_path / "still", make_frames(1), without=("motion", "motion_next"))
    document = run([str(still)], tmp_path / "out", EvaluateOptions(PLAIN, metrics=("psnr", "tpsnr")))
    (row, _) = document.results
    assert row["errors"]["frame"]["psnr"] > 0 and row["ms"]["steps"] == 1
    assert math.isnan(row["errors"]["frame"]["tpsnr"]) and math.isnan(row["ghost_length"])
    assert {path.name for path in report(tmp_path / "out")} == {"report.html", "report.md", "report.png"}


@pytest.mark.parametrize("layer", ["reference", "reference_half"])
def test_references_that_are_not_finite_are_refused(layer, tmp_path, capsys):
    frames = make_frames(3)
    bad = getattr(frames[1], layer).clone()
    bad[..., 2, 3], bad[:, 0, 4, 5] = math.nan, math.nan
    frames[1] = replace(frames[1], **{layer: bad})
    shot = write_sequence(tmp_path / "shot", frames)
    with pytest.raises(SystemExit, match="2"):
        main(["evaluate", str(shot), "--out", str(tmp_path / "out"), "--methods", "noisy"])
    message = capsys.readouterr().err
    assert "frame.0001.exr" in message and f"layer {layer}: NaN or Inf in 2 pixels" in message
    assert message.count("\n") == 1


HOSTILE = "a $x$ <script>alert(1)</script> | ${y} `z`"


def test_names_of_folders_mean_nothing_to_the_report(tmp_path):
    name = HOSTILE.replace("/", "")
    shot = write_sequence(tmp_path / name, make_frames(3))
    run([str(shot)], tmp_path / "out", EvaluateOptions((*PLAIN, "svgf", "paper"), metrics=("psnr", "ssim")))
    report(tmp_path / "out")
    text = (tmp_path / "out" / "report.md").read_text()
    assert "<script>" not in text and "&lt;script&gt;" in text and r"\$x\$" in text and r"\|" in text
    assert "alert(1)" not in (tmp_path / "out" / "report.html").read_text().replace("&lt;script&gt;alert(1)", "")
    assert (tmp_path / "out" / "report.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (4, 1200, [10, 30, 100, 300, 1000]),
        (0.018, 0.9, [0.02, 0.05, 0.1, 0.2, 0.5]),
        (0.08, 0.34, [0.1, 0.15, 0.2, 0.25, 0.3]),
        (0.02706, 0.02794, [0.0272, 0.0274, 0.0276, 0.0278]),
        (1e-9, 1e9, [1e-9, 1e-6, 1e-3, 1, 1e3, 1e6, 1e9]),
    ],
)
def test_ticks_of_a_logarithmic_axis_are_few_round_numbers(low, high, expected):
    assert tick_values(low, high) == pytest.approx(expected)


@pytest.mark.parametrize("milliseconds", [(41,), (7, 40, 950)])
def test_the_chart_has_plain_numbers_on_its_axes(milliseconds, monkeypatch):
    rows = [
        {
            "sequence": "s", "spp": 1, "label": f"{ms}", "method": "ours", "device": "cpu", "ms": {"median": ms},
            "errors": {"frame": {"psnr": 20.0, "relmse": 2 / ms, "flip": 0.2}}, "front": {"frame": []},
        } for ms in milliseconds
    ]  # fmt: skip
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, file, format: drawn.append(figure))
    chart({"rows": rows, "methods": {"ours": {"family": "network"}}, "ours": "ours"})
    for axes in drawn[0].axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = axis.get_view_interval()
            ticks = axis.get_majorticklocs()
            texts = axis.get_major_formatter().format_ticks(ticks)
            assert sum(low <= tick <= high for tick in ticks) >= 2 and not len(axis.get_minorticklocs())
            assert [float(text) for text in texts] == pytest.approx(ticks)


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    """An evaluation.json as JSON."""
    folder = tmp_path_factory.mktemp("content")
    shot = write_sequence(folder / "shot", make_frames(2))
    run([str(shot)], folder / "out", EvaluateOptions(("noisy",), metrics=("psnr",)))
    return json.loads((folder / "out" / "evaluation.json").read_text())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(extra=1), "unknown key 'extra'; expected signal, runs"),
        (lambda c: c.pop("signal"), "key 'signal' is missing"),
        (lambda c: c.update(results={}), "key 'results': expected a JSON array"),
        (lambda c: c["results"][0].pop("ms"), "results, 0: key 'ms' is missing"),
        (lambda c: c["results"].append(3), "results, 1: expected a JSON object, found 3"),
        (lambda c: c["sequences"]["shot"].pop("stills"), "sequences, shot: key 'stills' is missing"),
        (lambda c: c["methods"].clear(), "results, 0: method 'noisy' is not among 'methods'"),
        (
            lambda c: c["methods"]["noisy"].update(family="magic"),
            "methods, noisy: family 'magic'; expected",
        ),
        (lambda c: c["runs"].clear(), "results, 0: run 0 is not among 'runs'"),
        (lambda c: c["results"][0].update(errors={}), "expected errors of the region 'frame'"),
    ],
)
def test_a_document_with_missing_or_foreign_keys_is_one_line(change, message, content, tmp_path, capsys):
    changed = json.loads(json.dumps(content))
    change(changed)
    (tmp_path / "evaluation.json").write_text(json.dumps(changed))
    with pytest.raises(SystemExit, match="2"):
        main(["report", str(tmp_path)])
    error = capsys.readouterr().err
    assert message in error and str(tmp_path / "evaluation.json") in error and error.count("\n") == 1


def places(value, path=()):
    """Where the values of a JSON document are, all of them."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [*([path] if path else []), *(place for key, item in inner for place in places(item, (*path, key)))]


@pytest.mark.parametrize("wrong", [None, [], {}, "x", 1.5], ids=repr)
def test_a_document_with_a_wrong_value_anywhere_is_reported_or_refused(wrong, content, tmp_path):
    refused = 0
    for *path, last in places(content):
        changed = json.loads(json.dumps(content))
        functools.reduce(lambda part, key: part[key], path, changed)[last] = wrong
        (tmp_path / "evaluation.json").write_text(json.dumps(changed))
        try:
            document = Document.read(tmp_path)
            data = payload(document)
        except InputError:
            refused += 1
            continue
        assert page(data, document, tmp_path) and markdown(data)
    assert refused > 20


def test_nine_methods_unless_asked_for():
    """The last is what `denoise` does by itself."""
    assert [method.name for method in choose(())] == list(DEFAULTS) and len(DEFAULTS) == 9
    assert DEFAULTS[-1] == f"{BEST[0]}-ahead{AHEAD}"
    assert [method.name for method in choose(("all",))] == list(methods())


def test_references_in_other_files(tmp_path, capsys):
    frames, out = make_frames(3), tmp_path / "out"
    shot = write_sequence(tmp_path / "shot", frames, without=("reference", "reference_half"))
    converged = [replace(frame, radiance=frame.reference, reference=None, reference_half=None) for frame in frames]
    truth = write_sequence(tmp_path / "truth", converged)
    command = ["evaluate", str(shot), "--out", str(out), "--methods", "noisy,accumulate", "--metrics", "psnr"]
    main([*command, "--reference", str(truth)])
    expected = evaluate(frames, PLAIN, metrics=("psnr",))
    found = {row["method"]: row["errors"]["frame"]["psnr"] for row in Document.read(out).results}
    for result in expected:
        assert found[result.method] == pytest.approx(result.errors["frame"]["psnr"], abs=0.02)  # half floats
    fewer = write_sequence(tmp_path / "fewer", converged[:2])
    for wrong, message in (
        ([], "reference"), (["--reference", str(fewer)], "expected 3 frames 0 to 2 of 32×24 as in"),
        (["--reference", str(truth), str(truth)], "expected a folder for each of the 1 sequences, got 2"),
        (["--reference", str(shot)], "frame.0000.exr: is the same picture as"),
    ):  # fmt: skip
        with pytest.raises(SystemExit, match="2"):
            main([*command, *wrong])
        assert message in (error := capsys.readouterr().err) and error.count("\n") == 1


def test_every_sequence_and_device_has_a_table_of_its_own(tmp_path):
    for name, spp in (("one", 1), ("four", 4)):
        shot = write_sequence(tmp_path / name, make_frames(2))
        (shot / "samples.json").write_text(f'{{"spp": {spp}}}')
    shots = [str(tmp_path / name) for name in ("one", "four")]
    document = run(shots, tmp_path / "out", EvaluateOptions((*PLAIN, "paper"), metrics=("psnr",)))
    text = markdown(payload(document))
    assert "light, 1 and 4 spp, 2 sequences: one, four." in text and "In 0 of 4 comparisons" in text
    assert "\n## one, 1 spp\n" in text and "\n## four, 4 spp\n" in text
    for row in [row for row in document.results if row["sequence"] == "one"]:
        document.put(row | {"device": "cuda"})
    text = markdown(payload(document))
    assert "\n## one, 1 spp, cpu\n" in text and "\n## one, 1 spp, cuda\n" in text


def test_a_report_of_half_precision_alone_has_all_parts(shot, tmp_path):
    out, options = tmp_path / "out", EvaluateOptions(PLAIN, metrics=("psnr",))
    run([str(shot)], out, options)
    document = run([str(shot)], out, replace(options, methods=("paper",), precisions=("bf16",)))
    found = payload(document)
    assert found["ours"] == "paper bf16" and len(found["lost"]) + len(found["won"]) == 2
    assert "comparisons with rtdenoise `paper bf16`" in markdown(found) and "1.00×" in markdown(found)
    text = page(found, document, out)
    for kind in ("image", "flip", "strip"):
        assert f'data-key="shot/paper bf16/{kind}"' in text
    picture = next(out.glob("pictures/shot/*/paper.exr"))
    half = picture.read_bytes()
    document = run([str(shot)], out, replace(options, methods=("paper",)))  # fp32 takes its place
    assert picture.read_bytes() != half and payload(document)["ours"] == "paper"
    full = picture.read_bytes()
    document = run([str(shot)], out, replace(options, methods=("paper",), precisions=("bf16",), metrics=("ssim",)))
    assert picture.read_bytes() == full and 'data-key="shot/paper/strip"' in page(payload(document), document, out)


def test_the_report_opens_in_a_browser(shot, tmp_path, monkeypatch, capsys):
    out, opened = tmp_path / "out", []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    run([str(shot)], out, EvaluateOptions(PLAIN, metrics=("psnr",)))
    for _ in range(2):
        main(["view", str(out)])
    assert opened == [(out / "report.html").resolve().as_uri()] * 2 and (out / "report.html").is_file()
    monkeypatch.setattr("webbrowser.open", Mock(side_effect=webbrowser.Error("could not locate runnable browser")))
    main(["view", str(out)])
    assert f"no browser to be found here; the report is {out / 'report.html'}" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="2"):
        main(["view", str(tmp_path / "nowhere")])
    assert "rtdenoise evaluate SEQ --out" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main(["view", str(out / "evaluation.json")])
    assert "evaluation.json: is no report; name the folder" in capsys.readouterr().err
