"""Put weights into the package in half precision, or the mean of several.

python tools/ship_weights.py NAME FILE [set:FIELD=VALUE ...]
python tools/ship_weights.py NAME FILE=SHARE FILE=SHARE ... [set:FIELD=VALUE ...]

NAME is that of a model that ships, or a path to write to. FILE is a file of weights or a model that ships. `set:`
changes a field of the configuration that has no weights (`set:recent=8`).

In a mean all networks are grown to the configuration of the last one. The mean of a network and one that was trained on
from it for other frames keeps most of what both know (Wortsman et al., Robust fine-tuning of zero-shot models, 2022).

Half precision rounds each weight by 0.05 % at most, a tenth of the error of bfloat16 inference, and halves the wheel.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import asdict
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save
from usage import call

from rtdenoise.files import in_order, write_atomically
from rtdenoise.models import grow, read
from rtdenoise.models.presets import with_settings
from rtdenoise.models.weights import find

SHIPPED = Path(__file__).parent.parent / "rtdenoise" / "weights"
SET = "set:"


def main(name: str, file: str, *more: str) -> None:
    words = file, *more
    parts = [word for word in words if not word.startswith(SET)]
    settings = [word.removeprefix(SET) for word in words if word.startswith(SET)]
    files, shares = zip(*map(parsed, parts), strict=True)
    if not math.isclose(sum(shares), 1):
        sys.exit(f"expected shares with the sum 1, got {sum(shares):g}")
    config = read(files[-1]).config
    states = [grown(file, config) for file in files]
    tensors = {
        key: sum(share * state[key] for share, state in zip(shares, states, strict=True)).to(torch.float16).contiguous()
        for key in states[-1]
    }
    with safe_open(find(files[-1]), framework="numpy") as file:
        metadata = file.metadata()
    if len(parts) > 1:
        told = json.loads(metadata.get("training", "{}")) | {"mean_of": list(parts)}
        metadata |= {"training": json.dumps(told)}
    if settings:
        metadata |= {"config": json.dumps(asdict(with_settings(config, settings)))}
    out = Path(name) if name.endswith(".safetensors") else SHIPPED / f"{name}.safetensors"
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(out, in_order(save(tensors, metadata=metadata)))


def parsed(part: str) -> tuple[str, float]:
    """(file, share) of FILE or FILE=SHARE."""
    file, equals, share = part.rpartition("=")
    return (file, float(share)) if equals else (part, 1.0)


def grown(file: str, config) -> dict[str, torch.Tensor]:
    """The weights of a file, as those of a network of `config`."""
    network = read(file)
    return (network if network.config == config else grow(network, config)).state_dict()


if __name__ == "__main__":
    call(main, __doc__)
