"""Numbers on the pages are measured ones, and names on them exist."""

import importlib
import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest

from bench.harness import read
from rtdenoise.cli.commands import parse
from rtdenoise.errors import InputError
from rtdenoise.run.denoise import denoise

ROOT = Path(__file__).parent.parent
BENCH, DOCS, NOTES = ROOT / "bench", ROOT / "docs", ROOT / "docs" / "notes"
PAGES = [ROOT / "README.md", ROOT / "samples" / "README.md", BENCH / "README.md", *DOCS.rglob("*.md")]
MEASURED = {path: text for path in PAGES if (text := path.read_text()) and NOTES not in path.parents}
# Modules of bench that make sections of pages: they have RESULT and tables(document) -> section -> Markdown.
WRITERS = sorted(path for path in BENCH.rglob("*.py") if "\ndef tables(" in path.read_text())


def load_bench(monkeypatch, path):
    """A module of bench, whether its folder is a package or a folder of scripts."""
    if (BENCH / "__init__.py").is_file():
        monkeypatch.setattr(sys, "path", [str(ROOT), *sys.path])
        return importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
    monkeypatch.setattr(sys, "path", [*sys.path, str(BENCH)])
    return importlib.import_module(path.stem)


def marked_sections(text):
    """name -> text between `<!-- name -->` and `<!-- /name -->`."""
    return {name: body for name, body in re.findall(r"<!-- ([^/].*?) -->\n(.*?)\n<!-- /\1 -->", text, re.S)}


@pytest.mark.parametrize("path", WRITERS, ids=lambda path: path.stem)
def test_sections_are_those_of_the_results(monkeypatch, path):
    bench = load_bench(monkeypatch, path)
    for section, table in bench.tables(read(bench.RESULT)).items():
        quoted = [found for text in MEASURED.values() if (found := marked_sections(text).get(section)) is not None]
        assert quoted or any(table in page.read_text() for page in PAGES), f"no page has the section {section}"
        for text in quoted:
            assert text == table, section


def test_every_marked_section_has_a_bench_that_writes_it(monkeypatch):
    benches = [load_bench(monkeypatch, path) for path in WRITERS]
    results = [(bench, path) for bench in benches for path in (bench.RESULT, *getattr(bench, "OTHER_RESULTS", ()))]
    known = {section for bench, path in results for section in bench.tables(read(path))}
    for page, text in MEASURED.items():
        if strays := marked_sections(text).keys() - known - {"sample-indirect", "sample-color"}:
            pytest.fail(f"{page.name}: nothing writes the sections {sorted(strays)}")


def test_the_bundled_sequences_table_is_that_of_its_result(monkeypatch):
    sample = load_bench(monkeypatch, BENCH / "sample.py")
    document = read(sample.RESULT)
    tables = {f"sample-{signal}": sample.table(document, signal) for signal in ("indirect", "color")}
    assert marked_sections((ROOT / "README.md").read_text())["sample-indirect"] == tables["sample-indirect"]
    card = marked_sections((DOCS / "reference" / "models" / "default.md").read_text())
    assert {section: card[section] for section in tables} == tables


def test_rows_that_model_cards_quote_are_rows_of_the_result(monkeypatch):
    sample = load_bench(monkeypatch, BENCH / "sample.py")
    document = read(sample.RESULT)
    rows = {row for signal in ("indirect", "color") for row in sample.table(document, signal).splitlines()}
    for card in (DOCS / "reference" / "models").glob("*.md"):
        for row in re.findall(r"^\| (?:\*\*)?(?:noisy, 1 spp|Intel OIDN|rtdenoise `).*$", card.read_text(), re.M):
            assert row in rows, f"{card.name}: {row}"


def test_the_latency_table_is_that_of_the_result(monkeypatch):
    latency = load_bench(monkeypatch, BENCH / "latency_720p.py")
    for result in (latency.RESULT, latency.ON_CUDA):
        document = read(result)
        assert latency.table(document, "720p") in (DOCS / "results" / "performance.md").read_text()
    for result, (_, precisions) in latency.SHORT.items():
        document = read(result)
        assert latency.short_table(document, "720p", precisions) in (DOCS / "results" / "performance.md").read_text()


def test_every_result_says_where_it_is_from():
    """Results of experiments that are over have a note instead of a script."""
    noted = {
        name for note in NOTES.glob("*.md") for name in re.findall(r"bench/results/([\w-]+\.json)", note.read_text())
    }
    for path in (BENCH / "results").glob("*.json"):
        document = read(path)
        assert {"command", "commit", "devices", "date"} <= document.keys(), path.name
        assert path.name in noted or any(BENCH.rglob(Path(document["command"].split()[1]).name)), (
            f"{path.name}: {document['command']} does not exist, and no page of docs/notes names the result"
        )


def anchors(page):
    """Anchors of a page's headings, spelled as GitHub spells them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", page.read_text(), flags=re.S), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_and_commands_of_the_documents_lead_somewhere():
    for page in PAGES:
        text = page.read_text()
        for link, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", text):
            if link.startswith("http"):
                continue
            target = page.parent / link if link else page
            assert target.exists(), f"{page.relative_to(ROOT)}: {link}"
            assert not anchor or anchor in anchors(target), f"{page.relative_to(ROOT)}: {link}#{anchor}"
        for script in re.findall(r"(?:python|sh) ((?:bench|tools)/[\w/]+\.(?:py|sh))", text):
            assert (ROOT / script).is_file(), f"{page.relative_to(ROOT)}: {script}"


def documented(page, command):
    """The command lines on a page that begin like this: the words of each, without its comment."""
    text = page.read_text().replace("\\\n", " ")
    lines = re.findall(rf"^ *({command} .*)$", text, re.M) + re.findall(rf"`({command}[^`\n]*)`", text)
    return [shlex.split(line, comments=True) for line in lines]


def test_documented_options_of_denoise_go_together(tmp_path):
    """Each command is refused for its input alone, which is not there, or for weights that are the reader's own."""
    pages = [ROOT / "README.md", *(DOCS / "use").glob("*.md"), *(DOCS / "reference").rglob("*.md")]
    lines = [(page.name, words) for page in pages for words in documented(page, "rtdenoise denoise")]
    assert len(lines) > 30
    expected = rf"{re.escape(str(tmp_path))}/missing: does not exist|no model 'runs/|my\.toml: cannot be read"
    for page, words in lines:
        needed = [] if "--out" in words else ["shot/", "--out", "clean/"]  # where the text names options alone
        options = parse([*words[1:2], *needed, *words[2:]]).settings
        with pytest.raises(InputError) as refused:
            denoise(str(tmp_path / "missing"), tmp_path / "out", options)
        assert re.match(expected, str(refused.value)), f"{page}: {shlex.join(words)}: {refused.value}"


def resolves(name):
    """Whether a dotted name is a module of the package, or an attribute of one, or of a class there."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError:
            continue
        for part in parts[length:]:
            found = getattr(found, part, None)
        return found is not None
    return False


def test_names_of_the_source_that_pages_mention_exist():
    for page in (page for page in PAGES if page.parent != BENCH):
        text = page.read_text()
        imports = re.findall(r"^from (rtdenoise[\w.]*) import (.+)$", text, re.M)
        names = re.findall(r"`(rtdenoise(?:\.[a-zA-Z_]+)+)\b", text)
        names += [f"{module}.{name}" for module, imported in imports for name in imported.split(", ")]
        for name in names:
            assert resolves(name), f"{page.relative_to(ROOT)}: {name}"
        for path in re.findall(r"`((?:rtdenoise|shaders|tests|tools|examples)/[\w/.-]+)`", text):
            assert [*ROOT.glob(path.replace("NAME", "*"))], (
                f"{page.relative_to(ROOT)}: {path}"
            )  # NAME: the reader's own


def test_pages_that_the_source_mentions_exist():
    folders = ("rtdenoise", "bench", "tools", "shaders", "tests", "examples")
    for path in (path for folder in folders for path in (ROOT / folder).rglob("*")):
        if path.suffix in (".py", ".sh", ".glsl", ".c"):
            for page in re.findall(r"\bdocs/[\w/-]+\.md", path.read_text()):
                assert (ROOT / page).is_file(), f"{path.relative_to(ROOT)}: {page}"


def test_every_page_is_reached_from_the_entry():
    reached, waiting = set(), [ROOT / "README.md"]
    while waiting:
        page = waiting.pop().resolve()
        if page in reached:
            continue
        reached.add(page)
        links = re.findall(r"\]\(([^)#\s]+\.md)[^)]*\)", page.read_text())
        waiting += [
            target for link in links if not link.startswith("http") and (target := page.parent / link).is_file()
        ]
    assert {page.resolve() for page in DOCS.rglob("*.md")} <= reached


def test_no_page_sends_its_reader_into_the_history():
    for page in [*PAGES, ROOT / "CHANGELOG.md"]:
        assert "git show" not in page.read_text(), page.name


def test_the_readmes_rooms_are_complete():
    (rooms,) = re.findall(r"## The rooms\n+```\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    # The names stand left of the two spaces that set off a description: `color, exposure    transfer curves …`.
    columns = [re.match(r" *((?:[\w./]+(?:, | )?)+)", line)[1] for line in rooms.splitlines() if line.strip()]
    named = {name.rstrip("/") for names in columns for name in re.split(r",? ", names) if name}
    package = ROOT / "rtdenoise"
    modules = {path.stem for path in package.glob("*.py")} - {"__init__"}
    folders = {path.name for path in package.rglob("*") if path.is_dir() and path.name != "__pycache__"}
    assert modules | folders <= named, f"missing: {sorted((modules | folders) - named)}"
    assert {"shaders", "tests", "bench", "docs", "examples", "tools", "samples"} <= named


def test_the_readmes_examples_run():
    codes = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    assert len(codes) == 3 and len([line for line in codes[0].splitlines() if line]) == 3  # lines to a clean frame
    layers = {name: np.ones((16, 24, c)) for name, c in (("color", 3), ("albedo", 3), ("normal", 3), ("depth", 1))}
    names = layers | {"motion": np.zeros((16, 24, 2))}
    for code in codes:
        exec(code.replace('"samples/mural"', repr(str(ROOT / "samples" / "mural-window"))), names)
    assert names["clean"].shape == (16, 24, 3)
