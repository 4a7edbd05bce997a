"""Small noisy sequences with known motion, as frames and as EXR files, without a renderer."""

import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from rtdenoise.constants import RECALL_RESET
from rtdenoise.data.clip_file import clip_path, write_clip
from rtdenoise.data.exr import write_layers
from rtdenoise.errors import InputError
from rtdenoise.frame import Frame
from rtdenoise.models import create, save
from rtdenoise.models.config import NetworkConfig, TemporalKPNConfig
from rtdenoise.models.weights import read_config
from rtdenoise.run.denoise import denoise

THIN = {"widths": (8, 12, 4, 8, 4), "down": (8, 12, 16, 8, 8), "up": (8, 16, 8, 12), "out": (8, 12, 16, 8)}
TINY = TemporalKPNConfig(widths=(4, 4, 4, 4))  # a network that runs in no time


def save_tiny(folder: Path, config=TINY) -> Path:
    """Write a network with random weights, always the same. Returns its file."""
    torch.manual_seed(0)
    save(create(config), path := folder / "tiny.safetensors")
    return path


def thin(name: str) -> NetworkConfig:
    """The configuration of a model that ships, with thin networks."""
    config = read_config(name)
    return replace(config, **{field.name: THIN[field.name] for field in fields(config) if field.name in THIN})


def message(function, *args, **kwargs) -> str:
    """The text of the `InputError`, which must be one line."""
    with pytest.raises(InputError) as caught:
        function(*args, **kwargs)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def make_frames(count=4, H=24, W=32, seed=0, noise=1.0):
    """A square slides over a textured wall by 2 px a frame; both are lit evenly, and the noise is exponential."""
    g = torch.Generator().manual_seed(seed)
    y, x = torch.meshgrid(torch.arange(H).float(), torch.arange(W).float(), indexing="ij")
    frames = []
    for number in range(count):
        left = 6 + 2 * number
        inside = (x >= left) & (x < left + 8) & (y >= 6) & (y < 16)
        wall = 0.5 + 0.4 * torch.sin(x * 1.3) * torch.sin(y * 0.9)
        square = 0.3 + 0.2 * torch.cos((x - left) * 1.7)
        albedo = torch.where(inside, square, wall)[None, None].expand(1, 3, H, W).contiguous()
        speed = torch.where(inside, 2.0, 0.0)
        still = torch.zeros_like(speed)
        reference = albedo * 2
        frames.append(Frame(
            radiance=reference * (1 + noise * (torch.empty(1, 3, H, W).exponential_(generator=g) - 1)),
            albedo=albedo,
            normal=torch.where(inside, 1.0, 0.0)[None, None] * torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1),
            depth=torch.where(inside, 3.0, 8.0)[None, None],
            motion=torch.stack([-speed, still])[None],
            motion_next=torch.stack([speed, still])[None],
            reference=reference,
            reference_half=reference,
            number=number,
        ))  # fmt: skip
    return frames


def behind_glass(count=2, speed=(0.5, 0.0), bright=9.0, noise=0.0, seed=0, surface=4.0, H=96, W=144):
    """A bright window with dark bars behind a still pane; each pixel is one sample at a random place in it."""
    g = torch.Generator().manual_seed(seed)
    rows, columns = torch.meshgrid(torch.arange(H).float(), torch.arange(W).float(), indexing="ij")
    frames = []
    for number in range(count):
        x = columns + torch.rand(H, W, generator=g) - speed[0] * number
        y = rows + torch.rand(H, W, generator=g) - speed[1] * number
        pane = (x % 24 > 8) & (y % 32 > 6)
        dark = 0.05 * torch.empty(H, W).exponential_(generator=g)
        light = torch.where(pane, bright * (1 + noise * torch.randn(H, W, generator=g)).clamp(min=0), dark)
        frames.append(Frame(
            radiance=light.expand(1, 3, H, W).contiguous(), albedo=torch.ones(1, 3, H, W),
            normal=torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1).repeat(1, 1, H, W),
            depth=torch.full((1, 1, H, W), surface), motion=torch.zeros(1, 2, H, W),
            motion_next=torch.zeros(1, 2, H, W), number=number,
        ))  # fmt: skip
    return frames


def write_sequence(folder, frames, without=()):
    """Write frames in the native layout as frame.0000.exr ..., both signals alike."""
    folder.mkdir(parents=True, exist_ok=True)
    for frame in frames:
        layers = {layer: tensor[0].permute(1, 2, 0).numpy() for layer, tensor in frame.layers() if layer not in without}
        layers["color"] = layers.pop("radiance")
        layers["indirect"] = layers["color"]
        if "reference" in layers:
            layers["indirect_reference"] = layers["reference"]
        if "reference_half" in layers:
            layers["indirect_reference_half"] = layers["reference_half"]
        write_layers(folder / f"frame.{frame.number:04d}.exr", layers, dtypes={"color": "float"})
    return folder


def write_clips(folder, seeds, size=24, reference_noise=0.0, lead_in=0):
    """A clip of four frames, and a lead-in, for each seed, in the format that rendering writes."""
    folder.mkdir(exist_ok=True)
    for index, seed in enumerate(seeds):
        frames, rng = [], np.random.default_rng(seed)
        for frame in make_frames(lead_in + 4, H=size, W=size, seed=seed):
            layers = {layer: t[0].permute(1, 2, 0).numpy() for layer, t in frame.layers()}
            layers["color"] = layers["indirect"] = layers.pop("radiance")
            layers["indirect_reference"] = layers["reference"]
            layers["indirect_reference_half"] = layers["reference_half"]
            layers["id"] = np.ones((size, size, 1))
            for name in ("reference", "indirect_reference") if reference_noise else ():
                layers[name] = layers[name] * (1 + reference_noise * rng.uniform(-1, 1, (size, size, 1)))
            if frame.number < lead_in:
                layers |= {name: np.zeros_like(layer) for name, layer in layers.items() if "reference" in name}
            frames.append(layers)
        facts = {"seed": seed, "generator": 1} | ({"lead_in": lead_in} if lead_in else {})
        write_clip(clip_path(folder, index), frames, facts)
    return folder


def with_bad_pixels(frame):
    radiance = frame.radiance.clone()
    radiance[..., 3, 3], radiance[..., 4, 9] = math.nan, math.inf
    return replace(frame, radiance=radiance)


def reset_of(kept):
    """The reset of a kept frame (`ops.kept`), `[B, 1, H, W]` in [0, 1]."""
    return (kept[:, RECALL_RESET : RECALL_RESET + 1] & -65536).view(torch.float32)


def assert_goes_on(shot, folder, options, count, when_stopped=lambda out: None):
    """A run that is stopped after `count` frames goes on to the files of an undisturbed one, byte by byte."""
    denoise(str(shot), folder / "whole", options)
    with pytest.raises(Stop):
        denoise(str(shot), folder / "parts", options, on_frame=stop_after(count))
    when_stopped(folder / "parts")
    assert denoise(str(shot), folder / "parts", options).skipped == count
    for path in sorted((folder / "whole").glob("*.exr")):
        assert path.read_bytes() == (folder / "parts" / path.name).read_bytes(), path.name


class Stop(Exception):
    """What `stop_after` raises."""


def stop_after(count):
    """An `on_frame` that stops a run after so many frames."""

    def on_frame(done, total):
        if done == count:
            raise Stop

    return on_frame
