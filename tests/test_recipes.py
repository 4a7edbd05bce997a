"""`tools/train_weights.sh`: commands that there are, and those by which the weights that ship were trained."""

import json
import os
import shlex
import subprocess
from itertools import pairwise
from pathlib import Path

import pytest
import tyro
from rtdenoise.cli.main.main import Command
from safetensors import safe_open

from rtdenoise.training.loop import _plain

ROOT = Path(__file__).parent.parent
RECIPE = ROOT / "tools" / "train_weights.sh"


def printed(model, **environment):
    """The commands as lists of words."""
    environment = {"PATH": os.environ["PATH"], "DRY": "1"} | environment
    result = subprocess.run(["sh", RECIPE, model], env=environment, capture_output=True, text=True, check=True)
    return [shlex.split(line) for line in result.stdout.splitlines()]


def parsed(commands):
    """The options of the training runs among them, every clip of which has its command."""
    commands = [tyro.cli(Command, args=words[1:]) for words in commands]  # exits where an option is none
    trained = [command.config for command in commands if hasattr(command, "config")]
    rendered = {str(command.out) for command in commands if not hasattr(command, "config")}
    assert {str(folder) for config in trained for folder in (*config.data, config.val)} <= rendered
    return trained


@pytest.mark.parametrize("model", ["default", "fast", "quality"])
def test_the_recipe_is_that_of_the_weights(model):
    *commands, ship = printed(model, SCENES="scenes")
    assert ship[-2:] == [f"runs/{model}-last/weights.safetensors", model]
    trained = parsed(commands)
    for before, config in pairwise(trained):
        assert config.init == before.out / "weights.safetensors"
    with safe_open(ROOT / "rtdenoise" / "weights" / f"{model}.safetensors", framework="np") as file:
        options = json.loads(file.metadata()["training"])
    plain = _plain(trained[-1])
    shared = options.keys() & plain.keys()  # older runs do not know of newer options
    assert {"preset", "steps", "lr", "cuts", "frames"} <= shared
    assert {key: options[key] for key in shared} == {key: plain[key] for key in shared}


def test_the_settings_differ_in_nothing_else():
    a, b, c = (_plain(config) for config in parsed(printed("settings", SCENES="scenes")))
    assert (a["motion"], a["occlusion_loss"]) == ("traditional", False)
    assert (b["motion"], b["occlusion_loss"]) == ("dual", False)
    assert (c["motion"], c["occlusion_loss"]) == ("dual", True)
    differing = {"motion", "occlusion_loss"}
    assert len({str({k: v for k, v in setting.items() if k not in differing}) for setting in (a, b, c)}) == 1


def test_several_processes_are_torchruns():
    train = [words for words in printed("fast", PROCESSES="2") if "--steps" in words]
    assert all(words[: words.index("train")][-3:] == ["-m", "--", "rtdenoise"] for words in train)


def test_scene_files_are_left_out_where_there_are_none():
    assert [sum("--scenes" in words for words in printed("fast", **given)) for given in ({}, {"SCENES": "x"})] == [0, 4]


def test_a_model_without_a_recipe_is_refused():
    result = subprocess.run(["sh", RECIPE, "paper"], capture_output=True, text=True)
    assert result.returncode == 2 and result.stderr == "expected default, fast, quality or settings, got 'paper'\n"
