"""Denoisers: a name or a file -> configuration -> network with its weights.

Each name is imported on first use: `presets` and `weights` need no torch.
"""

from importlib import import_module

_HOMES = {
    "AccumulatedKPN": "accumulated_kpn", "AccumulatedKPNConfig": "config", "COMBINERS": "presets",
    "Combined": "window", "Combiner": "combiner", "CombinerConfig": "combiner_config", "Config": "presets",
    "Denoiser": "denoiser", "GuidedAttention": "afgsa", "GuidedAttentionConfig": "afgsa_config",
    "Hybrid": "hybrid", "HybridConfig": "hybrid_config",
    "MLTDConfig": "mltd_config", "PRESETS": "presets", "RecurrentTransformer": "mltd", "STILLS": "presets",
    "Shrinkage": "shrinkage", "TemporalKPN": "temporal_kpn", "TemporalKPNConfig": "config", "Window": "window",
    "available": "weights", "available_combiners": "weights", "create": "loading", "find": "weights",
    "grow": "growing", "load": "loading", "load_combiner": "loading", "read": "loading", "save": "loading",
}  # fmt: skip
__all__ = [*_HOMES]


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)
