"""The report of made-up runs: it needs nothing else, says what it is about, and all its numbers agree."""

import json
import re
from html.parser import HTMLParser

import pytest
import synthetic_runs as runs
from rooms import two_rooms

from eagor.lab.eval.report import write_report
from eagor.lab.eval.results import read, summarise
from eagor.lab.eval.tables import PUBLISHED, shown, shown_metrics
from eagor.lab.tasks.task import configure, load
from eagor.lab.worlds.glb import export_glb

METHODS = ("centroid", "cent_circ", "grid", "eagor_paper", "vmf", "eagor")
VARIANTS = ("eagor:degree=7", "eagor:decode=mean", "eagor:floor=0.2")
MAKERS = {
    "waypoint": lambda: runs.waypoint(apartments=4, each=2, methods=(*METHODS, *VARIANTS)),
    "navigation": lambda: runs.navigation(apartments=4, each=2, methods=METHODS),
    "tracking": lambda: runs.tracking(apartments=4, methods=METHODS),
}
VOID = {"meta", "img", "br"}
PNG = "data:image/png;base64,"


class Page(HTMLParser):
    """Checks that elements nest, and keeps what the tests ask about."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.links, self.tags = [], [], [], []
        self.cells, self.row, self.captions = {}, None, []
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
    path = write_report(folder)
    assert path == folder / "report.html"
    return folder, path.read_text(encoding="utf-8"), summarise(read(folder))


def test_the_page_needs_nothing_else_and_can_be_read_aloud_and_on_a_phone(written):
    _, text, summary = written
    page = Page(text)
    tags = [tag for tag, _ in page.tags]
    assert "script" not in tags
    assert not re.search(r"url\(|@import|https?://", text)
    assert all(link.startswith(("#", PNG)) for link in page.links)
    assert {link[1:] for link in page.links if link.startswith("#")} == set(page.ids)
    assert ("meta", {"name": "viewport", "content": "width=device-width, initial-scale=1"}) in page.tags
    assert "prefers-color-scheme:dark" in text
    assert tags.count("table") == tags.count("caption") > 2
    (chart,) = (given for tag, given in page.tags if tag == "img")
    assert "Mean error at each step" in chart["alt"]
    assert all(colour in text for colour in set(re.findall(r"var\((--[\w-]+)\)", text)))
    wanted = {
        "waypoint": {"parts", "steps", "variants"},
        "navigation": {"parts", "steps", "strata", "failed"},
        "tracking": {"parts", "steps", "strata"},
    }
    assert set(page.ids) == wanted[summary["task"]] | {"figures"}
    if summary["task"] == "waypoint":
        assert all(f"Variants of eagor: {what}" in text for what in ("degree", "decode", "floor"))


def test_every_figure_of_the_main_table_is_the_summarys_and_stands_beside_the_published_one(written):
    _, text, summary = written
    page = Page(text)
    rows = page.cells[page.captions[0]][1:]
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


def test_development_seeds_are_no_results(tmp_path):
    flat = str(export_glb(two_rooms(), tmp_path / "flat.glb"))
    for world, tuned_on in ((flat, False), ("apartment", True)):
        values = {"perception": "truth", "episodes": 1, "seed": 0, "methods": ["eagor"], "world": world}
        assert configure(load("waypoint"), values).development is tuned_on
    records = runs.waypoint(apartments=1, each=1, methods=("eagor",))
    text = write_report(runs.write_run(tmp_path / "run", records, development=True)).read_text()
    assert "parameters were chosen on them" in text
    assert "Only one apartment" in text


def test_a_run_without_ours_or_with_failures_alone_still_has_a_report(tmp_path):
    records = runs.waypoint(apartments=2, each=1, methods=("grid", "vmf"))
    assert "vmf: " in write_report(runs.write_run(tmp_path / "a", records)).read_text()
    failed = {"key": "waypoint/1", "task": "waypoint", "attempt": 2, "status": "failed", "error": "none"}
    text = write_report(runs.write_run(tmp_path / "b", [failed])).read_text()
    assert "There are no results" in text
    assert "What the columns are" not in text
