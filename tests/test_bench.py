"""The benchmarks: scripts that start, results that say where they are from, OIDN that may be missing."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors.numpy import load_file, save_file
from synthetic import make_frames, write_clips

from bench import RESULTS, combine_clips, deep_combiner, harness, tables
from bench.latency.stages import staged
from bench.latency.tables import table
from rtdenoise import models
from rtdenoise.data.clip_file import clip_path
from rtdenoise.errors import InputError
from rtdenoise.render.options import ClipOptions

ROOT = Path(__file__).parent.parent
SCRIPTS = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for folder in ("bench", "bench/calibration", "bench/diagnosis")
    for path in sorted((ROOT / folder).glob("[!_]*.py"))
]
# As after `make demo`: importlib finds no module that is None in sys.modules.
WITHOUT_EXTRAS = "import sys, runpy; sys.modules |= {'pyoidn': None, 'matplotlib': None, 'flip_evaluator': None}; "


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_script_has_a_main_and_an_entry_in_the_readme(name):
    assert callable(importlib.import_module(name).main)
    assert f"python {name.replace('.', '/')}.py" in (ROOT / "bench" / "README.md").read_text()


def test_every_script_with_tables_is_rewritten_by_tables():
    modules = {name: importlib.import_module(name) for name in SCRIPTS if name != "bench.tables"}
    assert {name for name, module in modules.items() if hasattr(module, "tables")} == {
        f"bench.{name}" for name in tables.MODULES
    }
    for name in tables.MODULES:
        module = modules[f"bench.{name}"]
        assert module.RESULT.is_file() and all(page.is_file() for page in module.PAGES)


def test_times_that_are_kept_say_where_they_are_from(tmp_path):
    path, times = tmp_path / "a.json", [{"size": "720p", "fast": 5.0}]
    first = harness.publish(path, {"times": times}, devices={"torch": "another CPU"})
    for _ in range(2):  # also when they are kept again
        kept = harness.publish(path, {"rows": [1], **harness.times_kept(path)}, devices={"torch": "this CPU"})
        assert kept["times"] == times and kept["devices"] == {"torch": "this CPU"}
        assert kept["times_of"] == {fact: first[fact] for fact in ("date", "commit", "devices")}


def test_sets_that_are_not_measured_anew_say_where_they_are_from(tmp_path):
    path = tmp_path / "a.json"
    first = harness.publish(path, {"rows": [{"set": "a", "n": 1}, {"set": "b", "n": 2}]}, devices={"torch": "X"})
    for n in (3, 4):
        rows, sets_of = harness.sets_kept(path, {"b"})
        assert rows == [{"set": "a", "n": 1}] and sets_of["a"]["devices"] == first["devices"] == {"torch": "X"}
        harness.publish(path, {"rows": [*rows, {"set": "b", "n": n}], "sets_of": sets_of}, devices={"torch": "Y"})


def test_a_script_runs_by_its_path_from_anywhere(tmp_path):
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    command = [sys.executable, ROOT / "bench" / "calibration" / "cuts.py", "--help"]
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert result.returncode == 0 and "another shot" in result.stdout, result.stderr


def test_bad_input_is_one_line(tmp_path):
    script = ROOT / "bench" / "calibration" / "tune_baselines.py"
    result = subprocess.run([sys.executable, script, tmp_path / "none"], capture_output=True, text=True)
    assert result.returncode == 2 and result.stderr.count("\n") == 1 and "none" in result.stderr


@pytest.mark.parametrize("options", [{"levels": (4, 1)}, {"levels": (0, 1)}, {"half": 0}, {"windows": 0}])
def test_clips_of_combiners_have_references_of_samples_of_their_own(options, tmp_path):
    """Of other options the reference would be made of the noisy frames' samples."""
    with pytest.raises(InputError, match=r"^--(levels|half).*expected"):
        combine_clips.main(tmp_path / "clips", count=0, **options)
    assert [combine_clips.halves((1, 4, 16), 3, spp) for spp in (1, 4, 16)] == [10, 9, 3]


def test_a_damaged_checkpoint_of_the_deep_combiner_is_one_line(tmp_path):
    write_clips(tmp_path, [0])
    (tmp_path / "checkpoint.pt").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"checkpoint\.pt: not a checkpoint"):
        deep_combiner.main((tmp_path,), tmp_path)


def test_runs_for_combiners_do_not_go_on_with_other_options(tmp_path):
    (tmp_path / "clips").mkdir()
    clip = clip_path(write_clips(tmp_path / "clips" / "spp01", [0]), 0)
    facts = combine_clips.facts_of((1, 2, 4, 8, 16, 32), 12, 1, ClipOptions(0, (128, 128), 7, 21))
    save_file(load_file(clip), clip, {"clip": json.dumps(facts)})
    for other in ({"seed": 3}, {"half": 13}, {"levels": (1, 4)}, {"size": 64}, {"frames": 5}):
        with pytest.raises(InputError, match=r"clip_000000\.safetensors: was rendered with .* choose another --out"):
            combine_clips.main(tmp_path / "clips", count=0, **other)
    data, options = write_clips(tmp_path / "data", [0]), {"steps": 0, "batch": 1, "size": 16}
    asked = {"steps": 0, "batch": 1, "size": 16, "lr": 3e-4, "softmax": False, "seed": 0}
    network = deep_combiner.DeepCombiner()
    kept = 0, network.state_dict(), torch.optim.Adam(network.parameters()).state_dict(), asked
    torch.save(kept, tmp_path / "checkpoint.pt")
    deep_combiner.main((data,), tmp_path, **options)
    for other in ({"lr": 1e-3}, {"softmax": True}, {"steps": 2}):
        with pytest.raises(InputError, match=f"this run was started with {min(other)} = "):
            deep_combiner.main((data,), tmp_path, **(options | other))


def test_a_published_result_says_where_it_is_from_and_updates_its_pages(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", [str(ROOT / "bench" / "tiles.py"), "--size", "64x36"])
    page, other = tmp_path / "page.md", tmp_path / "other.md"
    page.write_text("before\n<!-- a -->\nold\n<!-- /a -->\nafter\n<!-- b -->\n<!-- /b -->\n")
    other.write_text("<!-- a -->\n<!-- /a -->\n")
    made = {"timing": harness.Timing(1.235, 0.1, 5), "ratio": 0.123456, "missing": float("nan")}
    document = harness.publish(
        tmp_path / "results" / "x.json", made, digits=3, pages=(page, other),
        tables=lambda d: {"a": f"{d['timing']['median_ms']} ms", "b": "new"},
    )  # fmt: skip
    assert document == harness.read(tmp_path / "results" / "x.json")
    assert document["command"] == "python bench/tiles.py --size 64x36"
    assert {"date", "commit", "versions"} <= document.keys() and document["devices"]["torch"] == harness.cpu()
    assert document["timing"] == {"median_ms": 1.235, "iqr_ms": 0.1, "calls": 5}
    assert document["ratio"] == 0.123 and document["missing"] is None
    assert page.read_text() == "before\n<!-- a -->\n1.235 ms\n<!-- /a -->\nafter\n<!-- b -->\nnew\n<!-- /b -->\n"
    assert other.read_text() == "<!-- a -->\n1.235 ms\n<!-- /a -->\n"


def test_rows_name_their_columns_once_and_are_read_as_they_were(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", [str(ROOT / "bench" / "tiles.py")])
    rows = [{"way": f"n{i}", "psnr": {"frame": i / 3, "parts": {}}, "ms": None if i % 2 else [i]} for i in range(30)]
    rows[3] |= {"frames": [{"number": 1}]}  # a row of another kind
    rows[5] |= {"ms": {"median": 1.5}}
    few, unlike = rows[:5], [{str(i): i} for i in range(20)]  # lists that stay as they are
    made = {"rows": rows, "few": few, "unlike": unlike, "numbers": [1] * 20}
    document = harness.publish(tmp_path / "x.json", made)
    assert {name: document[name] for name in made} == made
    text = (tmp_path / "x.json").read_text()
    assert text.count('"parts"') == 3 + len(few) and text.count("\n  [") == 30 + 3


def test_a_section_without_a_place_is_told_after_the_others_are_updated(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("<!-- a -->\n<!-- /a -->\n")
    with pytest.raises(SystemExit, match="<!-- b -->"):
        harness.insert_sections({"a": "1", "b": "2"}, (page,))
    assert page.read_text() == "<!-- a -->\n1\n<!-- /a -->\n"


def test_latency_without_oidn_and_matplotlib_says_how_to_get_them(tmp_path):
    arguments = ["latency_720p", "--quick", "--presets", "paper", "--backends", "eager"]
    arguments += ["--out", str(tmp_path / "l.json")]
    code = f"{WITHOUT_EXTRAS}sys.argv = {arguments}; runpy.run_path('bench/latency_720p.py', run_name='__main__')"
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    rows = (tmp_path / "l.md").read_text().splitlines()
    (oidn,) = [row for row in rows if row.startswith("| oidn")]
    assert "pip install 'rtdenoise[bench]'" in oidn and all(row.count("|") == rows[0].count("|") for row in rows)
    assert "l.png: not drawn: pip install 'rtdenoise[bench]'" in result.stdout and not (tmp_path / "l.png").exists()


@pytest.mark.parametrize("name", [name for name, config in models.PRESETS.items() if not config.reads])
def test_every_stage_of_every_model_is_timed(name):
    model, (first, second) = models.create(models.PRESETS[name]), make_frames(2)
    with torch.inference_mode():
        _, history = model.step(first)
        with staged(model, lambda: None) as ledger:
            timed, _ = model.step(second, history)
        assert min(ledger.seconds.values()) > 0 and min(ledger.bytes.values()) > 0
        assert torch.equal(model.step(second, history)[0], timed)


def test_the_latency_table_is_relative_to_oidn():
    document = harness.read(RESULTS / "latency_720p.json")
    (oidn,) = [line for line in table(document, "720p").splitlines() if line.startswith("| oidn high")]
    assert oidn.split(" | ")[6] == "1.00× as fast"
