"""Deep Combiner (Back et al. 2020): combine one noisy and one denoised frame with predicted 15×15 kernels.

    image_c = z_c + Σ_i w_i (y_i - z_i),    w ≥ 0, Σ_i w_i = 1

Six 5×5 convolutions on linear radiance and features predict the weights: ReLU over their sum, as in the authors' code,
or a softmax. Depth is an input here, divided by its mean; the authors' code subtracts it from itself.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor, nn
from torch.nn import functional as F

from ..errors import InputError
from ..files import write_atomically
from ..models.window import Combined, Window, comparable, with_features
from ..ops import apply_kernel
from ..ops.mean_distance import mean_distance

WIDTH, LAYERS, SIDE = 100, 6, 5
KERNEL = 15
FEATURES = 13  # y 3, z 3, albedo 3, normal 3, depth 1
STRIP = 64  # rows at a time: each pixel has 225 weights


class DeepCombiner(nn.Module):
    """The network, with `combine` and `offsets` as in `models.Combiner`."""

    offsets = (0,)  # frames that it looks at: the current one

    def __init__(self, softmax: bool = False) -> None:
        super().__init__()
        self.softmax = softmax
        widths = [FEATURES, *[WIDTH] * (LAYERS - 1), KERNEL**2]
        self.layers = nn.ModuleList(nn.Conv2d(a, b, SIDE, padding=SIDE // 2) for a, b in pairwise(widths))
        for layer in self.layers:
            nn.init.xavier_uniform_(layer.weight)
            nn.init.zeros_(layer.bias)

    @classmethod
    def load(cls, path: str | Path) -> DeepCombiner:
        """The network that `save` wrote. Raises InputError for weights that are not of this network, or not finite."""
        try:
            with safe_open(path, framework="pt") as file:
                network = cls((file.metadata() or {}).get("softmax") == "true")
            network.load_state_dict(load_file(path))
        except (SafetensorError, OSError, RuntimeError) as error:
            raise InputError(f"{path}: no weights of the deep combiner ({str(error).splitlines()[0]})") from None
        if not all(weights.isfinite().all() for weights in network.parameters()):
            raise InputError(f"{path}: holds weights that are not finite; train them again")
        return network.eval().requires_grad_(False)

    def save(self, path: str | Path) -> None:
        """Write the weights, and whether they go with a softmax."""
        metadata = {"softmax": str(self.softmax).lower()}
        write_atomically(Path(path), save(self.state_dict(), metadata=metadata))

    def combine(self, window: Window) -> Combined:
        """Correct the middle frame of a window from itself alone."""
        place = len(window.frames) // 2
        frame = with_features(window.frames[place])
        noisy, estimate = comparable(frame.radiance, window.estimates[place])
        depth = frame.depth / mean_distance(frame.depth)
        x = torch.cat([noisy, estimate, frame.albedo, frame.normal, depth], dim=1)
        for layer in self.layers[:-1]:
            x = F.relu(layer(x))
        correction = self._applied(x, noisy - estimate)
        return Combined((estimate + correction).clamp(min=0), correction.abs().mean(1, keepdim=True))

    def _applied(self, x: Tensor, residual: Tensor) -> Tensor:
        """The last layer and the kernels, strip by strip with the rows that both reach."""
        halo, H = KERNEL // 2 + SIDE // 2, x.shape[2]
        strips = []
        for top in range(0, H, STRIP):
            first, last = max(0, top - halo), min(H, top + STRIP + halo)
            logits = self.layers[-1](x[:, :, first:last])
            if not self.softmax:  # ReLU over the sum is the softmax of the logarithm
                logits = logits.clamp(min=1e-10).log()
            filtered = apply_kernel(residual[:, :, first:last], logits)
            strips.append(filtered[:, :, top - first : top - first + STRIP])
        return torch.cat(strips, dim=2)
