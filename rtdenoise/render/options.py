"""The options of a set of training clips."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError, did_you_mean
from ..files import fingerprint
from .metropolis import MetropolisOptions
from .scenes import wide

CAUSTIC = "caustic"  # generator of clips by Metropolis sampling
MAX_SHARD = 20  # letters of a shard


@dataclass(frozen=True)
class ClipOptions:
    """The clips of a set. A clip depends on these options and its number alone."""

    count: int = 300  # clips
    size: tuple[int, int] = (128, 128)  # height, width
    frames: int = 10
    seed: int = 0
    spp: int = 1  # samples per pixel of the noisy frames
    reference_error: float = 0.01  # relative squared error that a reference of beauty may have,
    reference_range: tuple[int, int] = (32, 512)  # with at least and at most this many samples a pixel
    reference_spp: int = 64  # generator 1: of an averagely noisy scene, from half to half as much again; pssmlt: of all
    max_depth: int = 6  # path edges
    workers: int = 2  # processes of one thread each
    shard: tuple[int, int] = (0, 1)  # (i, n): this run renders the scenes g with g mod n = i
    scenes: tuple[tuple[str, str], ...] = ()  # (scene file, motion file or "") to mix in
    generator: int = wide.VERSION  # 1: whole pictures of `procedural`; 2, 3: windows of `wide` scenes
    sun: float = 0.0  # share of the generated scenes with a sun
    calm: float = 0.0  # share of the scenes in which only the camera moves
    textures: str = ""  # folder of pictures that some surfaces get; "": none
    assets: str = ""  # folder of a library: compositions of it take the place of generated scenes; "": none
    allow_unlicensed: bool = False  # use assets without a licence
    lead_in: int = 0  # frames before these that have no references: clips begin with so much history
    repeats: int = 1  # renders of each still, with noise of their own
    most_spp: int | None = None  # with assets: at most so many samples a pixel of the noisy frames; None: 64 × spp
    ray: str = ""  # address of a Ray cluster that takes the place of processes here; "": none
    metropolis: MetropolisOptions | None = None  # clips of caustic scenes; None: path tracing

    @property
    def made_by(self) -> int | str:
        """The generator, as facts of clips name it."""
        return CAUSTIC if self.metropolis else self.generator

    @property
    def layers(self) -> tuple[str, ...]:
        """The optional layers of the clips."""
        if self.metropolis:
            return "position", "samples", "large", "small", "proposals"
        return ("samples", "albedo_reference", "normal_reference") if self.assets else ()

    @property
    def stills(self) -> bool:
        """Whether clips of assets are single frames: more cameras a scene, no motion."""
        return bool(self.assets) and self.frames == 1

    @property
    def frames_are_given(self) -> bool:
        """Whether all clips have `frames` frames; clips of assets without a lead-in differ in length."""
        return not self.assets or self.stills or self.lead_in > 0

    @property
    def takes_per_scene(self) -> int:
        """A scene is loaded, and its kernels compiled, once; takes of it differ in camera and motions."""
        if self.stills:
            return 4
        return 3 if self.assets else 1

    @property
    def windows_per_take(self) -> int:
        if self.generator == 1 or self.metropolis:
            return 1  # the whole picture
        if self.stills:
            return 3
        return 2 if self.assets else 4

    @property
    def length(self) -> int:
        """Frames of a clip where these are given, the lead-in included."""
        return self.lead_in + self.frames

    @property
    def filmed(self) -> int:
        """Frames for which a scene of generators 2 and 3 moves; clips are cut from these."""
        return self.length + self.frames

    @property
    def clips_per_scene(self) -> int:
        return self.takes_per_scene * self.windows_per_take

    @property
    def view(self) -> tuple[int, int]:
        """Height and width of the picture that windows are cut from, in sets without assets."""
        return 2 * self.size[0], 2 * self.size[1]

    def clip_seed(self, index: int) -> int:
        """The seed in the facts of clip `index`: with generator 1 its scene's, else that of the set."""
        return self.seed + index if self.generator == 1 and not self.metropolis else self.seed

    @property
    def textures_are_of(self) -> str | None:
        """The name of the folder of pictures."""
        return Path(self.textures).resolve().name if self.textures else None

    def scenes_are_of(self) -> dict:
        """The options that choose and light scenes, without paths of the machine.

        A folder holds clips of one such choice, one seed, size, length and number of samples.
        """
        if self.metropolis:
            spp = {"least_spp": self.spp, "reference_spp": self.reference_spp}
            return {"chains": self.metropolis.chains, "attribution": self.metropolis.attribution} | spp
        if self.generator == 1:
            return {}
        files = [[Path(file).parent.name, bool(motion)] for file, motion in self.scenes]
        motions = {Path(file).parent.name: fingerprint(Path(motion)) for file, motion in self.scenes if motion}
        choice = {"sun": self.sun, "calm": self.calm, "lead_in": self.lead_in, "motions": motions}
        choice |= {"files": files, "textures": self.textures_are_of, "reference_error": self.reference_error}
        if self.assets:
            spp = {"least_spp": self.spp, "most_spp": self.most_spp}
            choice |= {"assets": Path(self.assets).name, "stills": self.stills} | spp
        return choice


def parse_shard(text: str) -> tuple[int, int]:
    """(i, n) of 'i/n'. Raises InputError."""
    i, _, n = text.partition("/")
    if not (i.isdecimal() and n.isdecimal() and len(text) <= MAX_SHARD and int(i) < int(n)):
        raise InputError(f"--shard {text[:MAX_SHARD]}: expected i/n with 0 ≤ i < n, such as 0/4")
    return int(i), int(n)


def find_scenes(folder: Path, motions: Path | None, exclude: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """(scene file, motion file or "") of every FOLDER/NAME/scene.xml but the excluded, with MOTIONS/NAME.toml.

    Raises InputError where none is left, and where `motions` has a motion for none.
    """
    files = [f for f in sorted(Path(folder).glob("*/scene.xml")) if f.parent.name not in exclude]
    if not files:
        raise InputError(f"{folder}: no scenes found; expected folders NAME/scene.xml besides {', '.join(exclude)}")
    scripts = [Path(motions) / f"{f.parent.name}.toml" if motions else None for f in files]
    pairs = tuple((str(f), str(s) if s and s.is_file() else "") for f, s in zip(files, scripts, strict=True))
    if motions and not any(script for _, script in pairs):
        names = ", ".join(f"{f.parent.name}.toml" for f in files[:3])
        raise InputError(f"{motions}: no motion of these scenes found; expected files NAME.toml, such as {names}")
    return pairs


def require_scenes(folder: Path, names: set[str]) -> None:
    """Raise InputError for a name without FOLDER/NAME/scene.xml, such as a typo in what is to be left out."""
    known = {f.parent.name for f in Path(folder).glob("*/scene.xml")}
    for name in sorted(names - known):
        raise InputError(f"--exclude {name}: {folder} has no such scene{did_you_mean(name, sorted(known))}; expected "
                         "the NAME of a NAME/scene.xml")  # fmt: skip
