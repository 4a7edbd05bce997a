"""Dependencies point one way, and inference pulls in neither training nor rendering nor plotting."""

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent / "rtdenoise"
# A room (a folder, or a module of the top level) may import the rooms above it in this list, and its own modules.
ORDER = [
    ("errors", "constants", "wording"), ("color", "files", "frame"), ("ops",), ("exposure", "motion"),
    ("sanitise",), ("data",), ("splat", "history", "shift", "brightness"), ("models",),
    ("baselines", "glsl", "metrics"), ("run",), ("evaluate",), ("render", "training", "report"), ("cli",),
    ("__main__",),
]  # fmt: skip
RANK = {room: rank for rank, rooms in enumerate(ORDER) for room in rooms}


def imported_rooms(path):
    package = ("rtdenoise", *path.relative_to(ROOT).parts)[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            names = [
                (*base, *(node.module or "").split(".")) if node.module else (*base, alias.name) for alias in node.names
            ]
        elif isinstance(node, ast.Import):
            names = [tuple(alias.name.split(".")) for alias in node.names]
        else:
            continue
        for name in names:
            if name[0] == "rtdenoise" and len(name) > 1 and name[1] in RANK:
                yield name[1]


def test_dependencies_point_one_way():
    for path in ROOT.rglob("*.py"):
        room = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if room == "__init__":
            continue
        assert room in RANK, f"{path.name}: place the room {room} in ORDER"
        for other in imported_rooms(path):
            same = other == room
            assert same or RANK[other] < RANK[room], (
                f"{path.relative_to(ROOT)} imports {other}, which is not below {room}"
            )


def test_inference_imports_no_training_rendering_or_plotting():
    heavy = ["mitsuba", "drjit", "matplotlib", "skimage"]
    heavy += [f"rtdenoise.{room}" for room in ("training", "evaluate", "render", "cli")]
    code = f"import sys, rtdenoise, rtdenoise.run.denoise; sys.exit(sorted(set({heavy}) & set(sys.modules)) or 0)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


def test_text_files_are_utf_8_on_every_system():
    files = [*ROOT.rglob("*.py"), *(ROOT.parent / "examples").rglob("*.py")]
    nodes = [(path, node) for path in files for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))]
    calls = [(path, node) for path, node in nodes if isinstance(node, ast.Call)]
    calls = [call for call in calls if getattr(call[1].func, "attr", "") in ("read_text", "write_text")]
    told = [(path.name, node.lineno) for path, node in calls if "encoding" not in {word.arg for word in node.keywords}]
    assert len(calls) > 10 and told == []


def test_lines_of_c_and_shaders_fit():
    files = [*(ROOT / "ops" / "native").glob("*.[ch]"), *(ROOT.parent / "shaders").rglob("*.glsl")]
    lines = [(path, line) for path in files for line in path.read_text(encoding="utf-8").splitlines()]
    assert len(lines) > 3000 and [(path.name, line) for path, line in lines if len(line) > 132] == []
