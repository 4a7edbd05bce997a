"""Denoisers: name -> configuration -> weights. Each name is imported when it is asked for: configurations and weights
files are read without torch."""

from importlib import import_module

_HOMES = {
    "AccumulatedKPN": "accumulated_kpn", "TemporalKPN": "temporal_kpn", "PRESETS": "create", "Config": "create",
    "Denoiser": "create", "create": "create", "grow": "grow", "load": "load", "read": "load", "save": "load",
    "available": "weights", "find": "weights",
}  # fmt: skip
__all__ = [*_HOMES]


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value  # `create`, `load` and `grow` are also the names of modules: the function wins
    return value
