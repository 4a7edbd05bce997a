"""`rtdenoise train`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tyro.conf import OmitArgPrefixes

from ..training.config import TrainConfig
from .progress import progress_bar


@dataclass(frozen=True)
class Train:
    """Train a network on rendered clips; an existing run directory is resumed."""

    config: OmitArgPrefixes[TrainConfig]

    def run(self) -> None:
        from rich.progress import TextColumn

        from ..training.loop import train

        with progress_bar("training", TextColumn("{task.fields[loss]}")) as bar:
            task = bar.add_task("train", total=None, loss="")

            def on_step(step: int, steps: int, loss: float) -> None:
                shown = "" if math.isnan(loss) else f"loss {loss:.4f}"
                bar.update(task, completed=step, total=steps, loss=shown)

            weights = train(self.config, on_step)
        print(f"weights: {weights}")
