"""What the documents say is what was measured, and what they name is there."""

import importlib
import json
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "bench" / "README.md", *(ROOT / "docs").rglob("*.md")]


def test_the_tables_are_those_of_the_results(monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path, str(ROOT / "bench")])
    sample = importlib.import_module("sample")
    document = json.loads(sample.RESULT.read_text())
    assert sample.table(document, "indirect") in (ROOT / "README.md").read_text()
    for signal in ("indirect", "color"):
        assert sample.table(document, signal) in (ROOT / "docs" / "reference" / "models" / "paper.md").read_text()


PAGE_OF = {
    "results/quality.md": ("quality", "where", "bias"),
    "results/stability.md": ("stability", "cuts", "plan", "tiles", "files"),
    "results/training.md": ("optimisers", "activity", "generalisation", "patience", "pick_kernel"),
    "reference/models/paper.md": ("ablation",),
}


@pytest.mark.parametrize("name, page", [(name, page) for page, names in PAGE_OF.items() for name in names])
def test_sections_are_those_of_the_results(monkeypatch, name, page):
    monkeypatch.setattr(sys, "path", [*sys.path, str(ROOT / "bench")])
    bench, text = importlib.import_module(name), (ROOT / "docs" / page).read_text()
    for section, table in bench.tables(json.loads(bench.RESULT.read_text())).items():
        assert f"<!-- {section} -->\n{table}\n<!-- /{section} -->" in text, section


def test_the_latency_table_is_that_of_the_result(monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path, str(ROOT / "bench")])
    latency = importlib.import_module("latency_720p")
    document = json.loads((ROOT / "bench" / "results" / "latency_720p.json").read_text())
    assert latency.table(document, "720p") in (ROOT / "docs" / "results" / "performance.md").read_text()


def test_every_result_says_where_it_is_from():
    for path in (ROOT / "bench" / "results").glob("*.json"):
        document = json.loads(path.read_text())
        assert {"command", "commit", "devices", "date"} <= document.keys(), path.name
        assert (ROOT / document["command"].split()[1]).is_file(), f"{path.name}: {document['command']}"


def test_links_and_commands_of_the_documents_lead_somewhere():
    for page in PAGES:
        text = page.read_text()
        for link in re.findall(r"\]\(([^)#]+)\)", text):
            assert link.startswith("http") or (page.parent / link).exists(), f"{page.name}: {link}"
        for script in re.findall(r"python ((?:bench|tools)/\w+\.py)", text):
            assert (ROOT / script).is_file(), f"{page.name}: {script}"


def test_the_readmes_example_runs():
    (code,) = re.findall(r"```python\n(import rtdenoise.*?)```", (ROOT / "README.md").read_text(), re.S)
    exec(code.replace('"samples/mural"', repr(str(ROOT / "samples" / "mural"))), {})
