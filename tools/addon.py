"""Build the zip of the Blender add-on, with a wheel of rtdenoise in it: `make addon`, or

    python tools/addon.py WHEEL --out dist

The zip is an extension for Blender 4.2 and later: drag it into Blender's window, or Preferences > Get Extensions >
Install from Disk.
"""

from __future__ import annotations

import argparse
import tomllib
import zipfile
from pathlib import Path

ADDON = Path(__file__).resolve().parent.parent / "examples" / "blender" / "addon"


def build(wheel: Path, out: Path) -> Path:
    """Write `rtdenoise-blender-VERSION.zip` into the folder `out` and return its path."""
    manifest = tomllib.loads((ADDON / "blender_manifest.toml").read_text(encoding="utf-8"))
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{manifest['id']}-blender-{manifest['version']}.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for source in sorted([*ADDON.glob("*.py"), *ADDON.glob("*.toml")]):
            archive.write(source, source.name)
        archive.write(wheel, wheel.name)
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path, help="a wheel of rtdenoise, as `make wheel` builds it")
    parser.add_argument("--out", type=Path, default=Path("dist"), help="folder of the zip")
    options = parser.parse_args()
    print(build(options.wheel, options.out))


if __name__ == "__main__":
    main()
