"""The report of made-up runs: it needs nothing else, says what it is about, and all its numbers agree."""

import json
import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest
import synthetic_runs as runs
from rooms import two_rooms

from eagor.errors import EagorError, FormatError, WorldError
from eagor.lab.eval.report import write_report
from eagor.lab.eval.results import read, summarise
from eagor.lab.eval.tables import PUBLISHED, csv_of, shown, shown_metrics
from eagor.lab.tasks.task import configure, load
from eagor.lab.worlds.glb import export_glb
from eagor.lab.worlds.render import Frame

METHODS = ("centroid", "cent_circ", "grid", "eagor_paper", "vmf", "eagor")
VARIANTS = ("eagor:degree=7", "eagor:decode=mean", "eagor:floor=0.2")
MAKERS = {
    "waypoint": lambda: runs.waypoint(apartments=4, each=2, methods=(*METHODS, *VARIANTS)),
    "navigation": lambda: runs.navigation(apartments=4, each=2, methods=METHODS),
    "tracking": lambda: runs.tracking(apartments=4, methods=METHODS),
}
VOID = {"meta", "img", "br", "line", "rect", "circle", "polyline", "polygon", "path", "image"}


def place(world, seed, radius, scene_hash=None):
    """A room of 10 m with one thing in it, and a camera that sees a gradient."""
    free = np.zeros((200, 200), dtype=bool)
    free[2:-2, 2:-2] = True
    thing = SimpleNamespace(low=np.array([4.0, 4.0, 0]), high=np.array([4.5, 4.6, 1]))
    ground = SimpleNamespace(origin=np.zeros(2), cell=0.05, free=free, structure=~free)

    def panorama(position, world_R_body, height, **_):
        rgb = np.broadcast_to(np.linspace(0, 255, height, dtype=np.uint8)[:, None, None], (height, 2 * height, 3))
        return Frame(rgb=rgb, range=np.full(rgb.shape[:2], 9.0), ids=None)

    scene = SimpleNamespace(hash=scene_hash or runs.hash_of(seed), source=f"{world} {seed}", instances=(thing, thing))
    return SimpleNamespace(scene=scene, ground=ground, renderer=SimpleNamespace(panorama=panorama))


class Page(HTMLParser):
    """Checks that elements nest, and keeps what the tests ask about."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.links, self.tags = [], [], [], []
        self.cells, self.row, self.small, self.captions = {}, None, False, []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.tags.append((tag, given))
        if tag not in VOID:
            self.open.append(tag)
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given[name] for name in ("href", "src") if name in given]
        if tag == "tr":
            self.row = []
        if tag in ("td", "th") and self.row is not None:
            self.row.append("")

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        self.ids += [value for name, value in attributes if name == "id"]
        self.links += [value for name, value in attributes if name in ("href", "src")]

    def handle_endtag(self, tag):
        assert tag in VOID or self.open.pop() == tag
        if tag == "tr":
            self.cells.setdefault(self.captions[-1], []).append(self.row)
            self.row = None

    def handle_data(self, data):
        if self.open and self.open[-1] == "caption":
            self.captions.append(data)
        elif self.row and self.open[-1] in ("td", "th", "b"):
            self.row[-1] += data


@pytest.fixture(scope="module", params=MAKERS)
def written(request, tmp_path_factory):
    records = MAKERS[request.param]()
    folder = runs.write_run(tmp_path_factory.mktemp("runs") / request.param, records)
    path = write_report(folder, place)
    assert path == folder / "report.html"
    return folder, path.read_text(encoding="utf-8"), summarise(read(folder))


def test_the_page_needs_nothing_else(written):
    _, text, _ = written
    page = Page(text)
    assert "script" not in {tag for tag, _ in page.tags}
    assert not re.search(r"url\(|@import|https?://", text)
    assert all(link.startswith(("#", "data:image/png;base64,")) for link in page.links)
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    assert len(page.ids) == len(set(page.ids))


def test_the_page_can_be_read_aloud_and_on_a_phone(written):
    _, text, _ = written
    page = Page(text)
    assert ("meta", {"name": "viewport", "content": "width=device-width, initial-scale=1"}) in page.tags
    assert "prefers-color-scheme:dark" in text
    tags = [tag for tag, _ in page.tags]
    assert tags.count("table") == tags.count("caption") > 2
    pictures = [given for tag, given in page.tags if tag == "svg" and "aria-hidden" not in given]
    assert len(pictures) > 6
    assert all(given["role"] == "img" and len(given["aria-label"]) > 20 for given in pictures)
    for found in re.findall(r"<svg .*?</svg>", text, re.DOTALL):
        ET.fromstring(found)
    colours = set(re.findall(r"var\((--[\w-]+)\)", text))
    assert "--c-eagor" in colours
    assert colours <= set(re.findall(r"(--[\w-]+):#", text))
    assert "#fe00" not in text


def test_every_figure_of_the_main_table_is_the_summarys_and_stands_beside_the_published_one(written):
    _, text, summary = written
    page = Page(text)
    title = page.captions[0]
    rows = page.cells[title][1:]
    columns = shown_metrics(load(summary["task"]), summary)
    heads = [row[0] for row in rows]
    published = PUBLISHED[summary["task"]]
    assert [head for head in heads if head != "as published"] == [n for n in summary["methods"] if ":" not in n]
    for index, (head, *figures) in enumerate(rows):
        if head == "as published":
            printed = [published[heads[index - 1]].get(column.key) for column in columns]
            assert figures == ["–" if value is None else f"{value:g}" for value in printed]
        else:
            assert figures == [shown(summary["methods"][head][column.key], column) for column in columns]
    assert heads.count("as published") == len(published)
    assert ("one to one" in text) == bool(published)


def test_the_three_files_hold_the_same_numbers(written):
    folder, text, summary = written
    page = Page(text)
    marked = (folder / "tables.md").read_text(encoding="utf-8")
    for caption in page.cells:
        if f"## {caption}\n" in marked:
            part = marked.partition(f"## {caption}\n")[2].partition("\n## ")[0]
            lines = [line for line in part.splitlines() if line.startswith("| ")]
            stripped = [[re.sub(r"[*†‡]| \(.*", "", cell.strip()) for cell in line.split(" | ")] for line in lines]
            stripped = [[re.sub(r"^\| | \|$| (holds|open|reversed)", "", cell) for cell in row] for row in stripped]
            found = [[re.sub(r" \(.*", "", cell) for cell in row] for row in page.cells[caption]]
            assert stripped[1:] == found[1:]
    assert (folder / "tables.csv").read_text(encoding="utf-8") == csv_of(load(summary["task"]), summary)


def test_the_sections_are_those_of_the_task(written):
    _, text, summary = written
    ids = {name for name in Page(text).ids if not re.fullmatch("m[0-9a-f]{10}", name)}  # those are marks in charts
    wanted = {
        "waypoint": {"parts", "ordering", "steps", "coverage", "variants"},
        "navigation": {"parts", "ordering", "steps", "strata", "coverage", "failed"},
        "tracking": {"parts", "steps", "strata", "coverage"},
    }
    assert ids == wanted[summary["task"]] | {"figures", "episodes"}
    if summary["task"] == "waypoint":
        assert all(f"Variants of eagor: {what}" in text for what in ("degree", "decode", "floor"))


def test_three_episodes_are_shown_from_above_and_at_six_moments(written):
    _, text, _ = written
    assert text.count('href="data:image/png') == 3 * (1 + 6)
    assert all(f">The {kind}: red chair" in text for kind in ("best", "median", "worst"))
    assert "No pictures" not in text


def test_what_was_run_is_said(written):
    folder, text, summary = written
    config = json.loads((folder / "run.json").read_text())
    assert "success_distance 1" in text
    assert "not development seeds" in text
    assert "with results, " in text
    assert str(config["seed"]) in text
    if summary["failed"]:
        assert "2 units could not be run" in text
        assert "no way &lt;to&gt; the target &amp; back" in text


def test_the_same_run_gives_the_same_files(tmp_path):
    folder = runs.write_run(tmp_path, runs.waypoint(apartments=2, each=1, methods=("eagor", "vmf")))
    names = ("report.html", "tables.md", "tables.csv")
    write_report(folder, place)
    before = [(folder / name).read_bytes() for name in names]
    write_report(folder, place)
    assert [(folder / name).read_bytes() for name in names] == before


def test_a_world_that_cannot_be_made_again_leaves_a_note(tmp_path):
    folder = runs.write_run(tmp_path, runs.waypoint(apartments=2, each=1, methods=("eagor", "vmf")))

    def gone(world, seed, radius):
        raise WorldError(f"no world {seed}")

    assert "No pictures: no world 200" in write_report(folder, gone).read_text()
    other = write_report(folder, lambda *which: place(*which, scene_hash="f" * 16)).read_text()
    assert "made differently now" in other
    assert 'href="data:' not in other


def test_development_seeds_are_no_results(tmp_path):
    records = runs.waypoint(apartments=1, each=1, methods=("eagor",))
    text = write_report(runs.write_run(tmp_path, records, development=True), place).read_text()
    assert "parameters were chosen on them" in text
    assert "Only one apartment" in text
    assert "Means over" in text
    assert "bands" not in text
    assert "beyond chance" not in text


def test_nothing_was_tuned_on_scenes_of_others(tmp_path):
    flat = str(export_glb(two_rooms(), tmp_path / "flat.glb"))
    for world, tuned_on in ((flat, False), ("apartment", True)):
        values = {"perception": "truth", "episodes": 1, "seed": 0, "methods": ["eagor"], "world": world}
        assert configure(load("waypoint"), values).development is tuned_on
    records = runs.waypoint(apartments=1, each=1, methods=("eagor",))
    text = write_report(runs.write_run(tmp_path, records, world="flat.glb"), place).read_text()
    assert "development seeds" not in text


def test_a_run_without_ours_or_with_failures_alone_still_has_a_report(tmp_path):
    records = runs.waypoint(apartments=2, each=1, methods=("grid", "vmf"))
    page = write_report(runs.write_run(tmp_path / "a", records), place).read_text()
    assert "no episode with a result of eagor" in page
    failed = {"key": "waypoint/1", "task": "waypoint", "attempt": 2, "status": "failed", "error": "none"}
    text = write_report(runs.write_run(tmp_path / "b", [failed]), place).read_text()
    assert "There are no results" in text
    for needless in ("Cases behind each figure", "‡", "What the columns are"):
        assert needless not in text


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(FormatError, match=r"run\.json"):
        write_report(tmp_path)
    (tmp_path / "run.json").write_text('{"task": "waypoint"}')
    with pytest.raises(EagorError, match="no records"):
        write_report(tmp_path)
