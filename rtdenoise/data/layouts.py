"""The layout presets: how renderers name and scale their channels, converted to the conventions of `frame.py`.

native   This project's: `R,G,B` (in files of several parts also in one named color, rgba, RGBA or beauty), and
         `layers.py` for the others: `indirect.{R,G,B}`, `albedo.{R,G,B}`, `normal.{X,Y,Z}`, `depth.Z`, …
cycles   Blender/Cycles 3.x-5.x, multilayer EXR: `<ViewLayer>.<Pass>.<Channel>`. `Vector` holds previous − current in
         X,Y and current − next in Z,W, in pixels with y up. `Diffuse Indirect` is already divided by `Diffuse Color`.
         `Denoising Normal` is in camera space and `Normal` in world space, so `Normal` is preferred.
mitsuba  Mitsuba 3's `aov` integrator: `R,G,B` is the picture of the inner integrator, an AOV `name:type` becomes
         `name.{R,G,B}` (albedo), `name.{X,Y,Z}`, `name.T` (depth) or `name.I` (index). Usual names are recognised.
falcor   One file for each buffer, named by Falcor's frame capture (`*.GBufferRT.mvec.12.exr`) or renamed
         (`mvec_0012.exr`).
         `mvec` is previous − current in fractions of the picture, y down; `linearZ` is FLT_MAX or 0 for misses.
bmfr     The data set of Koskela et al. 2019, one file for each buffer: `color12.exr` (already divided by the albedo),
         `albedo12.exr`, `shading_normal12.exr`, `world_position12.exr`. The scenes do not move: depth and motion come
         from `world_position` and the cameras in `camera_matrices.h`.
oidn     The names of Open Image Denoise's training: `name_0001spp.{hdr,alb,nrm}.exr`, `name_ref.hdr.exr`; the frame
         number stands at the end of `name`. There is neither depth nor motion.
noisebase  Zarr arrays in zip files: `noisebase.py` turns them into channels.
"""

from __future__ import annotations

from .layers import COMPONENTS, LAYERS
from .layout import Layout, Rule, rules

NATIVE = Layout(
    "native",
    {
        **{name: rules(name, layer.components) for name, layer in LAYERS.items()},
        # `samples/mural` has the second name; its lossy compression would lose once more under another one.
        "indirect_reference_half": rules("indirect_reference_half|half_indirect_reference", "RGB"),
        "color": rules("|color|rgba|RGBA|beauty", "RGB"),
        "components": (Rule(tuple(f"{name}.{c}" for name in COMPONENTS for c in "RGB"), (1,) * 3 * len(COMPONENTS)),),
    },
)

MITSUBA = Layout(
    "mitsuba",
    {
        **NATIVE.layers,
        "albedo": rules("albedo|alb|aov.albedo", "RGB"),
        "normal": rules("normal|nn|sh_normal|normals|n|sn|aov.sh_normal|geo_normal|gn", "XYZ"),
        "depth": rules("*", "T") + rules("depth", "Z"),
        "position": rules("position|pos|p|aov.position", "XYZ"),
        "id": rules("id|shape_index|shape|idx|index|aov.shape_index", "I"),
    },
    hints={
        "indirect": "Mitsuba has no integrator for it: render with `rtdenoise render`, or denoise --signal color",
        "albedo": "add `albedo:albedo` to the aov integrator's `aovs`",
        "normal": "add `normal:sh_normal` to the aov integrator's `aovs`",
        "depth": "add `depth:depth` to the aov integrator's `aovs`",
        "position": "add `position:position` to the aov integrator's `aovs`",
        "id": "add `id:shape_index` to the aov integrator's `aovs`",
        "motion": "Mitsuba has no motion AOV: render with `rtdenoise render`, or add channels motion.X, motion.Y",
        "motion_next": "Mitsuba has no motion AOV: render with `rtdenoise render`, or add motion_next.X, motion_next.Y",
    },
)

_DENOISING_DATA = "switch on View Layer > Passes > Data > Denoising Data"
_VECTOR = "switch on View Layer > Passes > Data > Vector, and motion blur off"
_CYCLES_HINTS = {
    "color": "switch on View Layer > Passes > Data > Combined",
    "indirect": "switch on View Layer > Passes > Light > Diffuse > Indirect",
    "albedo": _DENOISING_DATA,
    "indirect_albedo": "switch on View Layer > Passes > Light > Diffuse > Color",
    "normal": "switch on View Layer > Passes > Data > Normal",
    "depth": "switch on View Layer > Passes > Data > Z",
    "motion": _VECTOR,
    "motion_next": _VECTOR,
    "position": "switch on View Layer > Passes > Data > Position",
    "id": "switch on View Layer > Passes > Data > Indexes > Object Index",
}


def cycles(view_layer: str) -> Layout:
    """The passes of one view layer ("": channels without a view layer in front)."""
    p = f"{view_layer}." if view_layer else ""
    layers = {
        "color": rules(f"{p}Noisy Image|{p}Combined", "RGB"),
        "indirect": rules(f"{p}Diffuse Indirect|{p}DiffInd", "RGB"),
        "albedo": rules(f"{p}Denoising Albedo|{p}Diffuse Color|{p}DiffCol", "RGB"),
        "indirect_albedo": rules(f"{p}Diffuse Color|{p}DiffCol", "RGB"),  # divides Diffuse Indirect
        "normal": rules(f"{p}Normal|{p}Denoising Normal", "XYZ"),
        # Cycles stores 1e10 as the depth of misses.
        "depth": rules(f"{p}Depth|{p}Denoising Depth", "Z", miss=1e9),
        "motion": rules(f"{p}Vector", "XY", signs=(1, -1)),
        "motion_next": rules(f"{p}Vector", "ZW", signs=(-1, 1)),
        "position": rules(f"{p}Position", "XYZ"),
        "id": rules(f"{p}Object Index|{p}IndexOB", "X"),
    }
    references = {layer: rule for layer, rule in NATIVE.layers.items() if "reference" in layer}  # added by other tools
    return Layout(
        "cycles",
        {**references, **layers},
        _CYCLES_HINTS,
        demodulated=frozenset({"indirect"}),
        beauty=rules(f"{p}Combined", "RGB"),
        path=Rule((f"{p}Denoising Depth.Z",), (1,)),
        more_history=True,
        fog={
            "direct": rules(f"{p}Volume Direct|{p}VolumeDir", "RGB"),
            "indirect": rules(f"{p}Volume Indirect|{p}VolumeInd", "RGB"),
            "sky": rules(f"{p}Environment|{p}Env", "RGB"),
        },
    )


FALCOR = Layout(
    "falcor",
    {
        "color": rules("color", "RGB"),
        "albedo": rules("albedo", "RGB"),
        "normal": rules("normal", "RGB") + rules("normal", "XYZ"),
        "depth": tuple(rule for c in "RZY" for rule in rules("linearZ", c, miss=1e30)),
        "motion": rules("mvec", "RG", scale="uv") + rules("mvec", "XY", scale="uv"),
        "reference": rules("ref", "RGB"),
    },
    hints={
        "indirect": "Falcor has no output for it; denoise --signal color",
        "motion_next": "Falcor has no output for it; it is approximated from motion and depth",
    },
    buffers={
        "color": ("color_{frame}.exr", "*.color.{frame}.exr"),
        "albedo": ("albedo_{frame}.exr", "*.albedo.{frame}.exr", "*.diffuseOpacity.{frame}.exr"),
        "normal": ("normal_{frame}.exr", "*.guideNormal.{frame}.exr", "*.normW.{frame}.exr"),
        "linearZ": ("linearZ_{frame}.exr", "*.linearZ.{frame}.exr"),
        "mvec": ("mvec_{frame}.exr", "*.mvec.{frame}.exr"),
        "ref": ("ref_{frame}.exr",),
    },
)

BMFR = Layout(
    "bmfr",
    {
        "color": rules("color", "RGB"),
        "albedo": rules("albedo", "RGB"),
        "normal": rules("shading_normal", "RGB"),
        "position": rules("world_position", "RGB"),
    },
    hints={
        "indirect": "BMFR's color holds direct and indirect light; denoise --signal color",
        **dict.fromkeys(("depth", "motion", "motion_next"), "put camera_matrices.h beside the frames"),
    },
    demodulated=frozenset({"color"}),
    buffers={name: (f"{name}{{frame}}.exr",) for name in ("color", "albedo", "shading_normal", "world_position")},
    cameras="camera_matrices.h",
)

_NOT_OIDN = "OIDN's names have no file for it: write native layers, or describe your files in a layout of your own"
OIDN = Layout(
    "oidn",
    {
        "color": rules("hdr", "RGB"),
        "albedo": rules("alb", "RGB"),
        "normal": rules("nrm", "RGB") + rules("nrm", "XYZ"),
        "reference": rules("ref", "RGB"),
    },
    hints=dict.fromkeys(("indirect", "depth", "motion", "motion_next", "position", "id"), _NOT_OIDN),
    buffers={
        "hdr": ("*{frame}_{spp}spp.hdr.exr", "*_{spp}spp.hdr.exr"),
        "alb": ("*{frame}_{spp}spp.alb.exr", "*_{spp}spp.alb.exr"),
        "nrm": ("*{frame}_{spp}spp.nrm.exr", "*_{spp}spp.nrm.exr"),
        "ref": ("*{frame}_ref.hdr.exr", "*_ref.hdr.exr"),
    },
)

LAYOUTS = {layout.name: layout for layout in (NATIVE, MITSUBA, FALCOR, BMFR, OIDN)}
NAMES = ("native", "cycles", "mitsuba", "falcor", "bmfr", "oidn", "noisebase")
