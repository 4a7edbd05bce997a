"""The networks that there are, by name; configurations from weights files and from settings. Needs no torch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, replace

from ..errors import InputError
from .afgsa_config import GuidedAttentionConfig
from .combiner_config import CombinerConfig
from .config import AccumulatedKPNConfig, TemporalKPNConfig
from .hybrid_config import HybridConfig
from .mltd_config import MLTDConfig

Config = TemporalKPNConfig | AccumulatedKPNConfig | CombinerConfig | GuidedAttentionConfig | MLTDConfig | HybridConfig
CONFIGS: dict[str, type[Config]] = {
    kind.architecture: kind
    for kind in (
        TemporalKPNConfig, AccumulatedKPNConfig, HybridConfig, CombinerConfig, GuidedAttentionConfig, MLTDConfig,
    )
}  # fmt: skip

DEFAULT = {"widths": (32, 56, 72, 88, 104), "edge_kernel": 3, "detail": True}  # also the kernels of `hybrid`
PRESETS: dict[str, Config] = {
    "paper": TemporalKPNConfig(),
    "fast": AccumulatedKPNConfig(widths=(16, 24, 32, 48, 64), kernel=3, edge_kernel=3),
    "default": AccumulatedKPNConfig(**DEFAULT),
    "hybrid": HybridConfig(**DEFAULT),
    "hybrid-fast": HybridConfig(**DEFAULT, down=(32,) * 5, up=(32, 64, 64, 64), out=(32, 32, 64, 64)),
    "hybrid-large": HybridConfig(
        **DEFAULT, down=(64, 96, 128, 192, 256), up=(64, 96, 128, 192), out=(64, 96, 128, 192), twice=True, clean=True,
    ),
    "mltd": MLTDConfig(),
    "mltd-small": MLTDConfig(width=16, blocks=(1,) * 8, kernel=7),
}  # fmt: skip
"""Name of a denoiser -> its configuration, for training. Shipped weights hold their own."""

STILLS: dict[str, GuidedAttentionConfig] = {
    "afgsa": GuidedAttentionConfig(mirrored=False),
    "afgsa-small": GuidedAttentionConfig(width=48, blocks=3),
}
"""Name of a denoiser of single frames -> its configuration: its paper's, and one that a CPU can train."""

COMBINERS: dict[str, CombinerConfig] = {
    "combiner": CombinerConfig(),
    "combiner-causal": CombinerConfig(frames=3, causal=True),
    "drc": CombinerConfig(
        widths=(48, 64, 96, 128), half_size=False, kernel=15, pick_kernel=5, evidence=False, squares=False,
        relative=False, statistics=False,
    ),
}  # fmt: skip
"""Name of a combiner -> its configuration: ours, ours without future frames, and its paper's."""
SHRINKAGE = "shrinkage"
"""Name of the combiner without weights, `shrinkage.Shrinkage`."""


def from_stored(architecture: str, values: Mapping[str, object]) -> Config:
    """The configuration in a weights file. Raises ValueError where it is none of this version."""
    if architecture not in CONFIGS:
        raise ValueError(f"expected an architecture of {', '.join(CONFIGS)}, got {architecture!r}")
    if unknown := values.keys() - {field.name for field in fields(CONFIGS[architecture])}:
        raise ValueError(f"unknown field {min(unknown)!r}")
    try:
        return CONFIGS[architecture](**values)
    except TypeError as error:
        raise ValueError(str(error)) from None


def with_settings(config: Config, settings: Iterable[str]) -> Config:
    """`config` with fields replaced as `NAME=VALUE` says, e.g. `widths=32,48,64` or `motion=traditional`.

    Raises InputError for a setting of another form, an unknown field, or a value that the field cannot have.
    """
    known = {field.name: getattr(config, field.name) for field in fields(config)}
    changes: dict[str, object] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals or name not in known:
            raise InputError(f"--set {setting}: expected NAME=VALUE with a NAME of {', '.join(known)}")
        try:
            changes[name] = _parsed(value, known[name])
        except (ValueError, KeyError):
            raise InputError(f"--set {setting}: expected a value like {_shown(known[name])}") from None
    try:
        return replace(config, **changes)
    except ValueError as error:
        raise InputError(f"--set {' '.join(settings)}: {error}") from None


def _parsed(text: str, like: object) -> object:
    if isinstance(like, bool):
        return {"true": True, "false": False}[text.lower()]
    if isinstance(like, tuple):
        return tuple(int(part) for part in text.split(","))
    return type(like)(text)


def _shown(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value).lower()
