"""Load a scene into Mitsuba 3. Mitsuba is imported inside functions: without it this module still imports."""

from __future__ import annotations

import contextlib
import glob
import os
import re
import sys
from itertools import product
from pathlib import Path

import numpy as np

from ..errors import InputError
from .scenes.scene import Material, Object, Principled, Scene

LLVM_PATTERNS = ("/usr/lib/*/libLLVM*.so*", "/usr/lib/llvm-*/lib/libLLVM*.so*", "/usr/lib64/libLLVM*.so*")


def start_mitsuba(threads: int | None = None):
    """The mitsuba module with a variant set: CUDA where it works, else LLVM, which is found by `find_llvm` on Linux and
    by Mitsuba elsewhere. `threads`: CPU threads, None for all."""
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH") or find_llvm()
    if chosen:
        os.environ["DRJIT_LIBLLVM_PATH"] = chosen
    try:
        import drjit as dr
        import mitsuba as mi
    except ImportError as error:
        raise InputError("rendering needs Mitsuba 3, which is missing: pip install 'rtdenoise[render]'") from error
    if mi.variant() is None:
        if dr.has_backend(dr.JitBackend.CUDA):
            mi.set_variant("cuda_ad_rgb")
        elif dr.has_backend(dr.JitBackend.LLVM) and (chosen or not sys.platform.startswith("linux")):
            mi.set_variant("llvm_ad_rgb")
        else:
            raise InputError("rendering needs a CUDA device or LLVM 16 or newer, found neither: apt install libllvm19, "
                             "or name the library in the environment variable DRJIT_LIBLLVM_PATH")  # fmt: skip
        mi.set_log_level(mi.LogLevel.Error)
    if threads:
        dr.set_thread_count(threads)
    return mi


def find_llvm(patterns: tuple[str, ...] = LLVM_PATTERNS) -> str | None:
    """Path of the newest libLLVM of version 16 or later; older ones abort in Mitsuba's kernels."""
    found = []
    for path in (p for pattern in patterns for p in glob.glob(pattern)):
        version = re.search(r"(\d+)", Path(path).name.removeprefix("libLLVM").replace(".so.", "-"))
        if version and int(version[1]) >= 16:
            found.append((int(version[1]), path))
    return max(found)[1] if found else None


class Stage:
    """A scene loaded into Mitsuba; `at(t)` puts every object where it is at frame t."""

    def __init__(self, scene: Scene):
        mi = start_mitsuba()
        import drjit as dr

        self.scene, self.exposure, self.time = scene, scene.exposure, None
        # One BSDF of every kind lives as long as the stage: kernels then contain the same kinds for all scenes and are
        # found in the cache.
        grey = np.full((4, 4, 3), 0.5, np.float32)
        self.kinds = [_bsdf(mi, Material(grey, kind)) for kind in ("diffuse", "plastic", "metal", "glass")]
        self.holes = any(isinstance(o.material, Principled) for o in scene.objects)  # see `tracing`
        if self.holes:
            one = grey[..., :1]
            self.kinds += [
                _bsdf(mi, Principled(grey, one, one, normal, alpha, transmission))
                for normal, alpha, transmission in product((None, grey), (None, one), (0.0, 1.0))
            ]
        self.mitsuba = _build(mi, scene)
        owner = {name: o for o in scene.objects for name in (o.shapes or (f"object_{o.id}",))}
        moving = {name: o for name, o in owner.items() if o.motion is not None}

        # A ray reports the shape by its id in Mitsuba's registry, which changes with every load.
        numbers = {dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s))[0]: s.id() for s in self.mitsuba.shapes()}
        table = np.zeros(max(1 << 12, max(numbers) + 1), np.uint32)  # mostly the same size, for the kernel cache
        for number, name in numbers.items():
            table[number] = owner[name].id
        self.object_ids = mi.UInt32(table)

        self._parameters = mi.traverse(self.mitsuba) if moving else {}
        self._poses: dict[str, np.ndarray] = {}  # parameter -> the pose that it has now, where it is not at rest
        for name, o in moving.items():
            if f"{name}.vertex_positions" not in self._parameters:
                raise InputError(f"shape '{name}' of object '{o.name}' is no mesh: only meshes can move")
        self._rest = [
            (o.id, key, np.array(self._parameters[key]).reshape(-1, 3))
            for name, o in moving.items()
            for key in (f"{name}.vertex_positions", f"{name}.vertex_normals")
            if key in self._parameters
        ]

    def direct(self, scene: Scene) -> Stage:
        """Give the same objects other motions, and the scene another camera; only objects that had a motion get one."""
        self.scene, self.time = scene, None
        return self

    def at(self, t: float) -> Stage:
        """Move everything to frame t."""
        mi = start_mitsuba()
        if self._rest and t != self.time:
            poses = {o.id: o.motion(t) for o in self.scene.objects if o.motion is not None}
            for id, key, rest in self._rest:
                pose = poses.get(id, np.eye(4))
                if np.array_equal(pose, self._poses.get(key, np.eye(4))):
                    continue
                self._poses[key] = pose
                moved = rest @ pose[:3, :3].T + (pose[:3, 3] if key.endswith("positions") else 0)
                self._parameters[key] = mi.Float(moved.astype(np.float32).ravel())
            self._parameters.update()
        self.time = t
        return self


def load_file(path: Path):
    """The Mitsuba scene of an XML file with unmerged shapes: merging would lose their ids."""
    mi = start_mitsuba()
    try:
        with _two_threads():
            return mi.load_file(str(path), optimize=False)
    except RuntimeError as error:
        raise InputError(f"{path}: Mitsuba cannot load it: {_last_line(str(error))}") from error


@contextlib.contextmanager
def _two_threads():
    """At least two threads while a scene is loaded: with one, Mitsuba 3.9 deadlocks on some scenes, `parallel` or
    not."""
    import drjit as dr

    threads = dr.thread_count()
    dr.set_thread_count(max(threads, 2))
    try:
        yield
    finally:
        dr.set_thread_count(threads)


def _last_line(message: str) -> str:
    """The innermost of Mitsuba's nested messages, with the list that may follow it, as one line."""
    lines = message.strip().splitlines()
    start = max(i for i, line in enumerate(lines) if not line.lstrip().startswith("-") or i == 0)
    return " ".join(line.strip() for line in lines[start:])


def _build(mi, scene: Scene):
    """The scene of the file, if there is one, with the scene's own objects, lights and sky added."""
    made = {f"object_{o.id}": _shape(mi, o) for o in scene.objects if o.mesh is not None}
    if scene.file and not made and scene.sky is None and not scene.spots and scene.sun is None:
        return load_file(scene.file)
    description = _contents(mi, load_file(scene.file)) if scene.file else {"sensor": {"type": "perspective"}}
    if scene.sky is not None:
        description["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(scene.sky))}
    for i, spot in enumerate(scene.spots):
        description[f"spot_{i}"] = {
            "type": "spot", "intensity": {"type": "rgb", "value": list(spot.intensity)},
            "cutoff_angle": spot.angle, "beam_width": 0.6 * spot.angle,
            "to_world": mi.ScalarTransform4f().look_at(list(spot.origin), list(spot.target), [0, 0.02, 1]),
        }  # fmt: skip
    if scene.sun is not None:
        description["sun"] = {
            "type": "directional", "direction": [-x for x in scene.sun.towards], "sampling_weight": scene.sun.weight,
            "irradiance": {"type": "rgb", "value": list(scene.sun.irradiance)},
        }  # fmt: skip
    if clash := description.keys() & made.keys():
        raise InputError(f"{scene.file}: the id '{min(clash)}' is needed for an extra object; rename it in the file")
    with _two_threads():
        return mi.load_dict({"type": "scene"} | description | made, optimize=False)


def _contents(mi, loaded) -> dict:
    """Shapes, sensors and emitters (but those of a shape) of a loaded scene, as parts of a new one."""
    emitters = [e for e in loaded.emitters() if not mi.has_flag(e.flags(), mi.EmitterFlags.Surface)]
    shapes = {shape.id(): shape for shape in loaded.shapes()}  # Mitsuba uses the keys as ids
    return shapes | {f"part {i}": part for i, part in enumerate([*loaded.sensors(), *emitters])}


def _bitmap(mi, image: np.ndarray) -> dict:
    return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(image, np.float32)), "raw": True}


def _bsdf(mi, material: Material | Principled):
    if isinstance(material, Principled):
        return mi.load_dict(_principled(mi, material))
    texture, alpha = _bitmap(mi, material.texture), float(material.roughness)
    kinds = {
        "diffuse": {"type": "diffuse", "reflectance": texture},
        "plastic": {"type": "roughplastic", "diffuse_reflectance": texture, "alpha": alpha},
        "metal": {"type": "roughconductor", "material": "none", "specular_reflectance": texture, "alpha": alpha},
        "glass": {"type": "dielectric"},
    }
    return mi.load_dict(kinds[material.kind])


def _principled(mi, material: Principled) -> dict:
    """Always the same few nestings of plugins, so that the kernels of all scenes are found in the cache."""
    bsdf = {
        "type": "principled", "base_color": _bitmap(mi, material.color),
        "roughness": _bitmap(mi, np.clip(material.roughness, 0.03, 1)), "metallic": _bitmap(mi, material.metallic),
    }  # fmt: skip
    if material.transmission > 0:
        return bsdf | {"spec_trans": material.transmission, "eta": material.ior}
    if material.normal is not None:
        bsdf = {"type": "normalmap", "normalmap": _bitmap(mi, material.normal), "nested": bsdf}
    bsdf = {"type": "twosided", "nested": bsdf}
    if material.alpha is not None:
        bsdf = {"type": "mask", "opacity": _bitmap(mi, material.alpha), "nested": bsdf}
    return bsdf


def _shape(mi, o: Object):
    properties = mi.Properties()
    properties["bsdf"] = _bsdf(mi, o.material)
    if o.emission is not None:
        plain = isinstance(o.emission, tuple)
        radiance = {"type": "rgb", "value": list(o.emission)} if plain else _bitmap(mi, o.emission)
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
    shape = mi.Mesh(
        f"object_{o.id}", len(o.mesh.vertices), len(o.mesh.faces), properties,
        has_vertex_normals=True, has_vertex_texcoords=True,
    )  # fmt: skip
    parameters = mi.traverse(shape)
    parameters["faces"] = mi.UInt32(o.mesh.faces.ravel())
    parameters["vertex_positions"] = mi.Float(o.mesh.vertices.ravel())
    parameters["vertex_normals"] = mi.Float(o.mesh.normals.ravel())
    parameters["vertex_texcoords"] = mi.Float(o.mesh.uv.ravel())
    parameters.update()
    return shape
