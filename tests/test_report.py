"""The report in a real browser: it opens, shows the measured numbers, and its pictures equal the EXR files."""

import base64
import json
import re
import shutil
import zlib
from pathlib import Path

import numpy as np
import pytest
import torch
from browser import Browser
from PIL import Image
from synthetic import make_frames, write_sequence

from rtdenoise.cli.main import main
from rtdenoise.color import display
from rtdenoise.data.exr import read_channels
from rtdenoise.errors import InputError
from rtdenoise.evaluate.demo import SAMPLE
from rtdenoise.evaluate.document import Document
from rtdenoise.evaluate.options import EvaluateOptions
from rtdenoise.evaluate.run import run
from rtdenoise.report import report
from rtdenoise.report.pictures import encode_map, encode_motion

ARTEFACTS = Path(__file__).parent / "artefacts"
METHODS = ("noisy", "accumulate", "oidn", "paper")


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A folder with results and reports of the sample and of a sequence with a second input at 4 spp."""
    folder = tmp_path_factory.mktemp("report")
    square = write_sequence(folder / "square", make_frames(3, H=36, W=64))
    write_sequence(square / "spp4", make_frames(3, H=36, W=64, noise=0.5), without=("reference", "reference_half"))
    (square / "samples.json").write_text('{"sample_ms": 10.0}')
    out = folder / "out"
    run([str(SAMPLE), str(square)], out, EvaluateOptions(METHODS, spp=(1, 4), signal="indirect", frames=3))
    document = Document.read(out)
    decisions = [("warp of history", "3 of 3 frames examined", "where nothing moves"), ("tiles", "never", "small")]
    document.sequences["mural"]["plan"] = {
        "decisions": [dict(zip(("what", "left_out", "why"), decision, strict=True)) for decision in decisions]
    }
    document.write(out)
    report(out)
    return out


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture
def page(browser, measured):
    browser.problems.clear()
    browser.resize(1400, 1000)
    browser.open(measured / "report.html")
    browser.wait("document.getElementById('stage').dataset.ready")
    yield browser
    assert browser.problems == []


def choose(page, title, value):
    """Set a list of the toolbar or of the viewer."""
    page.value(f"""{{
        const list = document.querySelector('select[aria-label="{title}"]');
        list.value = {json.dumps(value)};
        list.dispatchEvent(new Event("change", {{ bubbles: true }}));
    }}""")


def press(page, value):
    page.value(f"""document.querySelector('button[data-value="{value}"]').click()""")


def shown(page, side="left", layer=0):
    """The picture on one side, or the mask over it (layer 1), `[H, W, 4]` in 0 … 255."""
    pixels = page.value(f"""(() => {{
        const canvas = document.querySelectorAll("#stage .side.{side} canvas")[{layer}];
        const all = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        return [canvas.height, canvas.width, Array.from(all.data)];
    }})()""")
    return np.array(pixels[2]).reshape(pixels[0], pixels[1], 4)


def played(page, name):
    """The frame that a player shows, `[H, W, 3]` in 0 … 255."""
    pixels = page.value(f"""(() => {{
        const canvas = document.querySelector("#players [data-method={name}] canvas");
        const all = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        return [canvas.height, canvas.width, Array.from(all.data)];
    }})()""")
    return np.array(pixels[2]).reshape(pixels[0], pixels[1], 4)[..., :3]


def test_it_opens_and_everything_is_drawn(page, measured):
    assert page.value("document.querySelector('h1').textContent") == "Denoisers compared"
    origin = page.value("document.querySelector('#origin').textContent")
    own = Document.read(measured).sequences["mural"]["reference_psnr"]
    assert float(re.search(r"mural320×180.*?%(\d+\.\d\d)", origin)[1]) == pytest.approx(own, abs=0.01)
    text = page.value("document.querySelector('#skipped').textContent")
    assert "warp of history (3 of 3 frames examined)" in text and "tiles" not in text and "no input at 4 spp" in text
    assert page.value("[...document.querySelectorAll('section')].filter((s) => s.hidden).length") == 0
    page.screenshot(ARTEFACTS / "report.png")


def test_pictures_stand_first_then_what_is_lost(page, measured):
    order = page.value("[...document.querySelectorAll('section')].map((section) => section.id)")
    assert order[:3] == ["playback", "compare", "verdict"]
    lost = page.value("document.querySelectorAll('#verdict td.peer').length")
    told = page.value("document.getElementById('verdict-text').textContent")
    assert lost and f"in {lost} of " in told and "oidn" in told
    first, second, *_ = (measured / "report.md").read_text().split("\n## ")[1:]
    assert first.startswith("Where a peer wins") and second.startswith("all sequences")


def test_the_chart_has_a_mark_a_method_and_tells_its_numbers(page, measured):
    choose(page, "Sequence", "mural")
    marks = page.value("[...document.querySelectorAll('#scatter-chart .mark')].map((m) => m.dataset.method)")
    assert sorted(marks) == ["accumulate", "oidn", "paper"]
    page.value("""document.querySelector('#scatter-chart .mark[data-method="paper"]')
        .dispatchEvent(new MouseEvent("mousemove", { clientX: 300, clientY: 300, bubbles: true }))""")
    result = Document.read(measured).find(sequence="mural", spp=1, method="paper", precision="fp32", device="cpu")
    assert f"{result['errors']['frame']['psnr']:.2f} dB" in page.value("document.getElementById('tip').textContent")


def test_rendering_counts_where_its_cost_is_known(page):
    choose(page, "Sequence", "square")
    press(page, "total")
    assert page.value("document.querySelectorAll('#scatter-chart .mark').length") == 8  # four methods at 1 and 4 spp
    assert "spp" in page.value("document.querySelector('#readings td:nth-child(2)').textContent")
    choose(page, "Sequence", "mural")
    assert page.value("document.querySelector('button[data-value=total]')") is None


def test_metric_region_and_sorting(page):
    choose(page, "Sequence", "mural")
    choose(page, "Metric", "relmse")
    choose(page, "Region", "uncovered")
    assert "relMSE (uncovered" in page.value(
        "document.querySelector('#scatter .title:nth-of-type(2), #scatter').textContent"
    )
    heading = "[...document.querySelectorAll('#table th button')].find((b) => b.textContent.startsWith('time'))"
    for expected in (1, -1):
        page.value(f"{heading}.click()")
        times = page.value("""[...document.querySelectorAll('#table tbody tr')].map((row) =>
            DATA.rows.find((r) => r.sequence === "mural" && r.label === row.cells[0].textContent).ms.median)""")
        assert times == sorted(times, reverse=expected < 0)


def test_a_method_can_be_switched_off(page):
    before = page.value("document.querySelectorAll('#frames polyline').length")
    page.value("[...document.querySelectorAll('#legend button')].find((b) => b.textContent === 'oidn').click()")
    assert page.value("document.querySelectorAll('#frames polyline').length") == before - 1


def test_errors_over_frames_have_a_point_a_frame(page, measured):
    choose(page, "Sequence", "mural")
    choose(page, "Metric", "psnr_corrected")
    shown = page.value("document.querySelectorAll('#frames circle').length")
    rows = [row for row in Document.read(measured).results if (row["sequence"], row["spp"]) == ("mural", 1)]
    known = [f for row in rows for f in row["frames"] if f["frame"]["psnr_corrected"] is not None]
    assert shown == len(known) > 0


def test_sequences_play_in_step(page, measured):
    choose(page, "Sequence", "mural")
    page.wait("document.getElementById('players').dataset.ready === 'mural'")
    names = page.value("[...document.querySelectorAll('#players figure')].map((f) => f.dataset.method)")
    assert names == ["noisy", "accumulate", "oidn", "paper", "reference"]
    first = page.value("player.frame")
    page.wait(f"player.frame !== {first}")  # it plays
    page.value("document.getElementById('play').click()")
    for frame in (0, 2):
        page.value(f"showFrame({frame})")
        sequence = Document.read(measured).sequences["mural"]
        height = sequence["playback"]["window"][2]
        with Image.open(measured / "playback" / "mural" / "oidn.webp") as strip:
            expected = np.asarray(strip.convert("RGB"))[frame * height : (frame + 1) * height]
        assert np.abs(played(page, "oidn") - expected).max() <= 2
        assert f"frame {sequence['frames'][frame]}" in page.value("document.getElementById('frame-number').textContent")
    result = Document.read(measured).find(sequence="mural", spp=1, method="oidn", precision="fp32", device="cpu")
    (psnr,) = (f["frame"]["psnr"] for f in result["frames"] if f["number"] == sequence["frames"][2])
    assert f"{psnr:.2f} dB" in page.value("document.querySelector('#players [data-method=oidn]').textContent")


def test_flicker_is_the_change_of_the_error(page):
    choose(page, "Sequence", "mural")
    page.wait("document.getElementById('players').dataset.ready === 'mural'")
    page.value("setPlaying(false)")
    press(page, "flicker")
    page.value("showFrame(1)")
    noisy, ours, truth = (played(page, name).astype(float).mean() for name in ("noisy", "paper", "reference"))
    assert noisy > 2 * ours > 0 and truth <= 2  # the reference has no error
    page.screenshot(ARTEFACTS / "flicker.png", whole=False)
    press(page, "picture")


def test_the_strip_shows_what_was_denoised(measured):
    sequence = Document.read(measured).sequences["mural"]
    still, (top, left, height, width) = sequence["stills"][0], sequence["playback"]["window"]
    planes = read_channels(measured / "pictures" / "mural" / f"{still:04d}" / "paper.exr", ["R", "G", "B"])
    image = torch.from_numpy(np.stack([planes[c] for c in "RGB"]))[:, top : top + height, left : left + width]
    expected = display(image, sequence["exposure"]).permute(1, 2, 0).numpy() * 255
    with Image.open(measured / "playback" / "mural" / "paper.webp") as strip:
        frame = sequence["playback"]["frames"].index(still)
        found = np.asarray(strip.convert("RGB"))[frame * height : (frame + 1) * height].astype(float)
    assert np.abs(found - expected).mean() < 4  # WebP


def test_a_page_without_strips_or_pictures_leaves_these_sections_out(browser, measured, tmp_path):
    shutil.copy(measured / "evaluation.json", tmp_path)
    report(tmp_path)
    browser.problems.clear()
    browser.open(tmp_path / "report.html")
    browser.wait("document.querySelector('#scatter svg')")
    hidden = browser.value("[...document.querySelectorAll('section')].filter((s) => s.hidden).map((s) => s.id)")
    assert hidden == ["playback", "compare"] and browser.problems == []


OVERLAPS = """(() => {
    const texts = [...document.querySelectorAll("figure svg text")], found = [];
    const boxes = texts.map((node) => [node, node.getBoundingClientRect()]);
    for (const [i, [a, p]] of boxes.entries()) {
        for (const [b, q] of boxes.slice(i + 1)) {
            const x = Math.min(p.right, q.right) - Math.max(p.left, q.left);
            const y = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
            if (x > 1 && y > 3) found.push(`${a.textContent} | ${b.textContent}`);
        }
    }
    return found;
})()"""


# Widths of the names as they are drawn, less those that places were chosen by.
MISJUDGED = """[...document.querySelectorAll("figure svg text.label")].map(
    (node) => node.getBoundingClientRect().width - nameWidth(node.textContent))"""


@pytest.fixture(scope="module")
def crowded(measured, tmp_path_factory):
    """The same with two dozen methods whose numbers are close together."""
    folder, rng = tmp_path_factory.mktemp("crowded"), np.random.default_rng(0)
    document = Document.read(measured)
    for row in [row for row in document.results if row["method"] in ("oidn", "paper")]:
        for i in range(10):
            name = f"{row['method']}-variant-{i}"
            document.methods[name] = document.methods[row["method"]]
            errors = {
                region: {m: v if v is None else v * rng.uniform(0.97, 1.03) for m, v in values.items()}
                for region, values in row["errors"].items()
            }
            ms = row["ms"] | {"median": row["ms"]["median"] * rng.uniform(0.8, 1.2)}
            document.results.append(row | {"method": name, "errors": errors, "ms": ms})
    document.write(folder)
    report(folder)
    return folder


@pytest.mark.parametrize("width", [1280, 420])
def test_nothing_overlaps_and_nothing_is_cut(browser, measured, crowded, width):
    browser.problems.clear()
    browser.resize(width, 900)
    for folder in (measured, crowded):
        browser.open(folder / "report.html")
        browser.wait("document.querySelector('#frames svg') || document.querySelector('#scatter svg')")
        for sequence in ("mural", "square"):
            choose(browser, "Sequence", sequence)
            assert browser.value(OVERLAPS) == []
            assert max(map(abs, browser.value(MISJUDGED))) < 1
        assert browser.value("document.documentElement.scrollWidth") <= width
        assert browser.value("parseFloat(getComputedStyle(document.querySelector('figure svg text')).fontSize)") >= 12
        assert browser.value("document.querySelector('figure svg').getBoundingClientRect().width") == pytest.approx(
            browser.value("document.querySelector('figure svg').viewBox.baseVal.width"), rel=0.1
        )  # text keeps its size
        browser.screenshot(ARTEFACTS / f"{folder.name.rstrip('0123456789')}-{width}.png")
    assert browser.problems == []


def test_a_family_has_a_colour_and_its_methods_have_shapes(browser, crowded):
    browser.open(crowded / "report.html")
    browser.wait("document.querySelector('#scatter svg')")
    styles = browser.value(
        "Object.values(STYLE).map(({ family, colour, shape }) => [family, colour, JSON.stringify(shape)])"
    )
    families = {family: {colour for f, colour, _ in styles if f == family} for family, _, _ in styles}
    assert all(len(colours) == 1 for colours in families.values())
    assert len({colour for _, colour, _ in styles}) == len(families)
    assert len({(family, shape) for family, _, shape in styles}) == len(styles)


def test_the_slider_moves(page):
    page.value("document.getElementById('stage').scrollIntoView({block: 'center'})")
    box = "document.getElementById('stage').getBoundingClientRect()"
    left, top, width, height = (page.value(f"{box}.{side}") for side in ("left", "top", "width", "height"))
    assert page.value("document.getElementById('stage').ariaValueNow") == "50"
    page.drag((left + width / 2, top + height / 2), (left + width / 4, top + height / 2))
    assert page.value("document.getElementById('stage').ariaValueNow") == "25"
    clip = page.value("getComputedStyle(document.querySelector('#stage .side.left')).clipPath")
    assert float(re.search(r"inset\(0px ([\d.]+)%", clip)[1]) == pytest.approx(75, abs=0.5)
    page.screenshot(ARTEFACTS / "slider.png", whole=False)
    page.scroll_wheel((left + width / 4, top + height / 2), -500)
    page.wait("viewer.scale > 1.5 * fitScale()")


def test_the_pictures_are_those_that_were_measured(page, measured):
    choose(page, "Sequence", "mural")
    page.wait("document.getElementById('stage').dataset.ready.startsWith('mural/paper/reference/image')")
    sequence = Document.read(measured).sequences["mural"]
    still = measured / "pictures" / "mural" / f"{sequence['stills'][0]:04d}"
    for stops in (0, 3):
        page.value(f"""{{
            const exposure = document.getElementById("exposure");
            exposure.value = {stops};
            exposure.dispatchEvent(new Event("input"));
        }}""")
        for side, name in (("left", "paper"), ("right", "reference")):
            planes = read_channels(still / f"{name}.exr", ["R", "G", "B"])
            image = torch.from_numpy(np.stack([planes[c] for c in "RGB"]))
            expected = display(image, sequence["exposure"] * 2**stops).permute(1, 2, 0).numpy() * 255
            assert np.abs(shown(page, side)[..., :3] - expected).max() < 3  # a step of the codes, and rounding


def test_flip_masks_and_motion_are_shown(page, measured):
    choose(page, "Sequence", "mural")
    choose(page, "Left", "noisy")
    page.wait("document.getElementById('stage').dataset.ready.startsWith('mural/noisy')")
    picture = shown(page)
    press(page, "flip")
    page.wait("document.getElementById('stage').dataset.ready.includes('/flip')")
    assert (
        not np.array_equal(shown(page), picture) and shown(page, "right")[..., :3].max() <= 4
    )  # the reference has no error
    press(page, "image")
    press(page, "uncovered")
    page.wait("document.getElementById('stage').dataset.ready.endsWith('image/uncovered')")
    still = Document.read(measured).sequences["mural"]["stills"][0]
    mask = read_channels(measured / f"pictures/mural/{still:04d}/reference.exr", ["uncovered.V"])["uncovered.V"]
    assert mask.sum() > 100 and np.array_equal(shown(page, layer=1)[..., 3] > 0, mask > 0.5)
    press(page, "motion")
    page.wait("document.querySelectorAll('#stage .side.left path').length === 3")
    assert page.value("document.querySelector('#stage .side.left path').getBoundingClientRect().width") > 1000
    page.value("document.getElementById('stage').scrollIntoView({block: 'center'})")
    page.screenshot(ARTEFACTS / "motion.png", whole=False)


def test_the_page_stands_alone(measured):
    text = (measured / "report.html").read_text()
    packed = re.search(r'data-key="data">([^<]*)<', text)[1]
    text += zlib.decompress(base64.b64decode(packed)).decode()
    assert '"rows":' in text
    assert not re.search(r"""(src|href)=["'](?!data:)""", text)
    links = set(re.findall(r"https?://[^\s\"'<)]+", text))
    assert links <= {"http://www.w3.org/2000/svg"}


def test_picture_and_markdown_beside_it(measured):
    text = (measured / "report.md").read_text()
    results = Document.read(measured)
    for row in results.results:
        if row["spp"] == 1:
            assert f"{row['errors']['frame']['psnr']:.2f}" in text
            assert row["sequence"] == "square" or f"{row['errors']['frame']['psnr_corrected']:.2f}" in text
    own = results.sequences["mural"]["reference_psnr"]
    assert 20 < own < 40 and f"The references' own error: {own:.2f} dB PSNR" in text
    assert (measured / "report.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_a_folder_without_results_is_one_line(tmp_path, capsys, measured):
    with pytest.raises(SystemExit) as stopped:
        main(["report", str(tmp_path)])
    assert stopped.value.code == 2 and "rtdenoise evaluate SEQ --out" in capsys.readouterr().err
    with pytest.raises(InputError, match="no method 'magic'"):
        report(measured, ("magic",))


def test_nan_is_the_greatest_error_of_a_map():
    assert encode_map(np.full((4, 6), np.nan)) == encode_map(np.ones((4, 6)))


def test_motion_that_is_unknown_is_none_in_the_page():
    """Without a warning of numpy."""
    broken = np.float32([[[np.nan, np.nan], [np.inf, -np.inf], [3e38, 0.25]]])
    with np.errstate(all="raise"):
        assert encode_motion(broken) == encode_motion(np.float32([[[0, 0], [2047.75, -2047.75], [2047.75, 0.25]]]))
