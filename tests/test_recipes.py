"""`tools/train_weights.sh`: its commands exist, and they are those that trained the shipped weights."""

import itertools
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from safetensors import safe_open

from rtdenoise.cli.commands import parse
from rtdenoise.training.loop import _compared as compared

ROOT = Path(__file__).parent.parent
RECIPE = ROOT / "tools" / "train_weights.sh"


def printed(model, **environment):
    """The commands that the script would run, as lists of words."""
    environment = {"PATH": os.environ["PATH"], "DRY": "1"} | environment
    result = subprocess.run(["sh", RECIPE, model], env=environment, capture_output=True, text=True, check=True)
    return [shlex.split(line) for line in result.stdout.splitlines()]


def folders_of(config):
    return *config.data, *config.stills, *([config.val] if config.val else [])


def parsed(words):
    """The options of the training runs among the commands; others must make the clips of these runs."""
    commands = [parse(line[1:]) for line in words if line[0] == "rtdenoise"]  # exits at an unknown option
    trained = [command.config for command in commands if hasattr(command, "config")]
    rendered = {str(command.out) for command in commands if hasattr(command, "out")}
    for line in (line for line in words if line[1] == "bench/combine_clips.py"):
        after = {option: line.index(option) + 1 for option in ("--out", "--levels")}
        levels = itertools.takewhile(str.isdigit, line[after["--levels"] :])
        rendered |= {f"{line[after['--out']]}/spp{int(level):02d}" for level in levels}
    assert {str(folder) for config in trained for folder in folders_of(config)} <= rendered
    return trained


@pytest.mark.parametrize("model", ["default", "fast", "many", "combiner"])
def test_the_recipe_is_that_of_the_weights(model):
    commands = printed(model, SCENES="scenes", ASSETS="library")
    shipped = [words[1:] for words in commands if words[1].endswith("ship_weights.py")]
    *means, ship = [[word for word in words if not word.startswith("set:")] for words in shipped]
    trained = parsed(commands)
    written = {str(config.out / "weights.safetensors") for config in trained} | {mean[1] for mean in means}
    assert {str(config.init) for config in trained if config.init} <= written
    assert {part.rpartition("=")[0] or part for mean in (*means, ship) for part in mean[2:]} <= written
    if model != "combiner":
        assert commands[-1][1:4] == ["tools/weights_in_bytes.py", model, f"rtdenoise/weights/{model}.int8"]
    assert ship[1] == model and f"runs/{model}-last/weights.safetensors" in ship[-1]
    with safe_open(ROOT / "rtdenoise" / "weights" / f"{model}.safetensors", framework="np") as file:
        options, config = (json.loads(file.metadata()[key]) for key in ("training", "config"))
    settings = [word.removeprefix("set:").split("=") for word in shipped[-1] if word.startswith("set:")]
    assert settings == ([["recent", str(config["recent"])]] if config.get("recent") else [])
    options.setdefault("model", options.pop("preset", None))  # the option's name when the shipped weights were trained
    last = next(config for config in trained if config.out.name == f"{model}-last")
    plain = compared(last)
    shared = options.keys() & plain.keys()  # options that are newer than the weights are not in their file
    assert {"model", "steps", "lr", "cuts", "frames"} <= shared
    assert {key: options[key] for key in shared} == {key: plain[key] for key in shared}


@pytest.mark.parametrize(
    ("model", "quality"), [("hybrid", "balanced"), ("hybrid-fast", "fast"), ("hybrid-large", "large")]
)
def test_hybrid_is_put_together_and_not_trained(model, quality):
    """tests/test_hybrid.py compares the weights that ship."""
    begin, *renders, in_bytes = words = printed(model, SCENES="scenes")
    assert begin[1:] == ["tools/begin_hybrid.py", f"rtdenoise/weights/{model}.safetensors", quality]
    assert len(renders) == 11 and all(words[:2] == ["rtdenoise", "render"] for words in renders)
    assert in_bytes[1:4] == ["tools/weights_in_bytes.py", model, f"rtdenoise/weights/{model}.int8"]
    parsed(words)
    assert len(printed(model)) == len(words) - 7  # without scene files


@pytest.mark.parametrize("pixels", ["hybrid", "hybrid-large"])
def test_hybrids_for_many_samples_are_joined(pixels, tmp_path):
    """To the file that ships."""
    ((_, tool, out, *models),) = printed(f"{pixels}-many")
    assert (Path(tool).name, out, models) == (
        "join_hybrid.py", f"rtdenoise/weights/{pixels}-many.safetensors", ["many", pixels]
    )  # fmt: skip
    subprocess.run([sys.executable, ROOT / "tools" / "join_hybrid.py", tmp_path / "w.safetensors", *models], check=True)
    made, ships = (safe_open(path, framework="numpy") for path in (tmp_path / "w.safetensors", ROOT / out))
    assert made.metadata() == ships.metadata() and not list(made.keys())


def test_the_settings_differ_in_nothing_else():
    a, b, c = (compared(config) for config in parsed(printed("settings", SCENES="scenes")))
    assert (a["motion"], a["occlusion_loss"]) == ("traditional", False)
    assert (b["motion"], b["occlusion_loss"]) == ("dual", False)
    assert (c["motion"], c["occlusion_loss"]) == ("dual", True)
    differing = {"motion", "occlusion_loss"}
    assert len({str({k: v for k, v in setting.items() if k not in differing}) for setting in (a, b, c)}) == 1


def test_several_processes_run_under_torchrun():
    train = [words for words in printed("fast", PROCESSES="2") if "--steps" in words]
    assert all(words[: words.index("train")][-3:] == ["-m", "--", "rtdenoise"] for words in train)


def test_scene_files_are_used_only_where_a_folder_is_named():
    assert [sum("--scenes" in words for words in printed("fast", **given)) for given in ({}, {"SCENES": "x"})] == [0, 4]


def test_a_model_without_a_recipe_is_refused():
    result = subprocess.run(["sh", RECIPE, "paper"], capture_output=True, text=True)
    assert result.returncode == 2
    known = "default, fast, many, hybrid, hybrid-fast, hybrid-large, hybrid-many, hybrid-large-many, combiner"
    assert result.stderr == f"expected {known} or settings, got 'paper'\n"


def test_the_gpu_check_needs_a_gpu(tmp_path):
    (tmp_path / "nvidia-smi").write_text("#!/bin/sh\nexit 9\n")
    (tmp_path / "nvidia-smi").chmod(0o755)
    result = subprocess.run(
        ["/bin/sh", ROOT / "tools" / "gpu_check.sh"],
        env={"PATH": f"{tmp_path}:/usr/bin:/bin"},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 2 and "expected an NVIDIA GPU and its driver, found none" in result.stderr


def test_the_gpu_check_takes_a_torch_that_is_there_and_wheels_from_a_folder(tmp_path):
    """Programs that only log their arguments stand in for the driver and for Python, whose torch sees a GPU."""
    log = tmp_path / "log"
    programs = {
        "nvidia-smi": "echo GPU",
        "python3": f'echo "$*" >> {log}; case "$*" in *find_spec*hypothesis) exit 1 ;; *venv*) exit 1 ;; esac',
    }
    for name, body in programs.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{body}\n")
        (tmp_path / name).chmod(0o755)
    environment = {"PATH": f"{tmp_path}:/usr/bin:/bin", "WHEELS": "wheels"}
    result = subprocess.run(
        ["/bin/sh", ROOT / "tools" / "gpu_check.sh"], env=environment, capture_output=True, text=True
    )
    assert "gpu_check: installing hypothesis\n" in result.stdout
    assert result.returncode == 2 and "python3 comes without venv; install hypothesis" in result.stderr
    assert "pip" not in log.read_text()
