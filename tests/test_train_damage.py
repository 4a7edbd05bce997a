"""Training on damaged files: a checkpoint, a log, a clip. One line names the file; the rest of the run stays."""

import json
import math
import os
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file, save_file
from synthetic import TINY, write_clips

from rtdenoise.errors import InputError
from rtdenoise.models import PRESETS
from rtdenoise.training.loop import train
from rtdenoise.training.trainer import TrainConfig

FACTS = {"clip": json.dumps({"seed": 0, "generator": 1})}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The options of a finished run."""
    folder = tmp_path_factory.mktemp("finished")
    config = TrainConfig(
        data=(write_clips(folder / "clips", range(3)),), out=folder / "run", model="tiny", steps=6, batch=2, frames=2,
        size=16, amp=False,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, "tiny", TINY)
        train(config)
    return config


@pytest.fixture
def config(finished, tmp_path, monkeypatch):
    """The same, in a copy of the folder."""
    monkeypatch.setitem(PRESETS, "tiny", TINY)
    shutil.copytree(finished.out, tmp_path / "run")
    return replace(finished, out=tmp_path / "run")


def damaged_checkpoints():
    """Name -> how a checkpoint comes to be damaged, and what the line says of it."""

    def changed(change):
        def damage(path):
            state = torch.load(path, weights_only=True)
            change(state)
            torch.save(state, path)

        return damage

    def poison(state):
        next(iter(state["model"].values())).fill_(math.nan)

    def reshape(state):
        state["optimisers"][0]["state"][0]["exp_avg"] = torch.zeros(3)

    return {
        "empty": (lambda path: path.write_bytes(b""), "not a checkpoint"),
        "truncated": (lambda path: path.write_bytes(path.read_bytes()[:-1000]), "not a checkpoint"),
        "text": (lambda path: path.write_text("step 4"), "not a checkpoint"),
        "no step": (changed(lambda state: state.pop("step")), "'step'"),
        "a step of text": (changed(lambda state: state.update(step="four")), "four"),
        "a step before the first": (changed(lambda state: state.update(step=-1)), "step -1"),
        "a step after the last": (changed(lambda state: state.update(step=7)), "is of step 7, the run has 6"),
        "another network": (changed(lambda state: state["model"].popitem()), "Missing key"),
        "not a dictionary": (lambda path: torch.save([1, 2], path), "not a checkpoint"),
        "weights that are not finite": (changed(poison), "is not finite"),
        "two optimisers": (changed(lambda state: state["optimisers"].append({})), "not a checkpoint"),
        "an optimiser of another network": (changed(reshape), "not of its parameter's shape"),
    }


@pytest.mark.parametrize("name", damaged_checkpoints())
def test_a_damaged_checkpoint_is_one_line(config, name):
    damage, expected = damaged_checkpoints()[name]
    damage(config.out / "checkpoint.pt")
    before = (config.out / "weights.safetensors").read_bytes()
    with pytest.raises(InputError) as caught:
        train(config)
    line = str(caught.value)
    assert line.startswith(str(config.out / "checkpoint.pt")) and expected in line and "\n" not in line, line
    assert (config.out / "weights.safetensors").read_bytes() == before


def test_a_checkpoint_that_would_run_code_does_not(config):
    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(config.out / "owned"),)

    torch.save({"step": Bomb()}, config.out / "checkpoint.pt")
    with pytest.raises(InputError, match="not a checkpoint"):
        train(config)
    assert not (config.out / "owned").exists()


@pytest.mark.parametrize("line", ["{", "[]", '{"loss": 1}', '{"step": "4"}', "\x00\x00", "[" * 100_000])
def test_a_damaged_line_in_the_log_is_one_line(config, line):
    rows = (config.out / "log.jsonl").read_text()
    (config.out / "log.jsonl").write_text(f"{line}\n{rows}")
    with pytest.raises(InputError, match=r"log\.jsonl: line 1 is damaged"):
        train(config)
    assert (config.out / "log.jsonl").read_text() == f"{line}\n{rows}"


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(path.read_bytes()[:-100]),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_text("a clip"),
        lambda path: save_file({"color": np.zeros((4, 3, 24), np.float16)}, path, FACTS),
        lambda path: save_file({n: a.astype(np.int32) for n, a in load_file(path).items()}, path, FACTS),
        lambda path: save_file({n: a[:2] if n == "depth" else a for n, a in load_file(path).items()}, path,
                               FACTS),
        lambda path: save_file({n: a[:, :1] for n, a in load_file(path).items()}, path, FACTS),
    ],
    ids=["truncated", "empty", "text", "three axes", "integers", "a short layer", "one channel"],
)  # fmt: skip
def test_a_damaged_clip_is_one_line(config, tmp_path, damage):
    folder = write_clips(tmp_path / "damaged", [0])
    (path,) = folder.iterdir()
    damage(path)
    with pytest.raises(InputError, match=r"clip_000000\.safetensors") as caught:
        train(replace(config, data=(folder,), out=tmp_path / "other"))
    assert "\n" not in str(caught.value)
