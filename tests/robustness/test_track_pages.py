"""Promised: a page opens from disk and asks for nothing, words from outside stay words, nothing computed is lost."""

import base64
import io
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image
from tracks_drawn import PANORAMA, turning

from eagor.drawing import page as pages
from eagor.drawing.page import BeliefPage
from eagor.drawing.step import StepPainter
from eagor.drawing.style import answer_in_words
from eagor.errors import EagorError, StorageError, TimeError
from eagor.grids import PerspectiveGrid

EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)> \" ' & $x ${title} `"
VOID = {"meta", "img", "input", "br", "link", "hr", "path", "line"}


class Reader(HTMLParser):
    """Elements with their attributes and text, and that tags are closed in order."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.open, self.texts = [], [], {}
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        assert len(dict(attrs)) == len(attrs)
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append((tag, dict(attrs).get("id")))

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        for tag, name in self.open:
            for key in {tag, name} - {None}:
                self.texts[key] = self.texts.get(key, "") + data

    def of(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]


def made(tmp_path, count=5, query="door", **how):
    path = tmp_path / "out.html"
    estimates = turning(count)
    with BeliefPage(path, query=query, **how) as page:
        for index, estimate in enumerate(estimates):
            page.add(PANORAMA, estimate, name=f"{index:04d}.png")
    text = path.read_text(encoding="utf-8")
    return estimates, text, Reader(text)


def shown(found):
    return json.loads(found.texts["steps"])["steps"]


def test_a_page_asks_for_nothing(tmp_path):
    _, text, found = made(tmp_path)
    text = re.sub(r"data:image/jpeg;base64,[A-Za-z0-9+/=]+", "", text)
    assert not re.search(r"https?:|//[a-z]|url\(|@import|\bfetch\(|XMLHttp|WebSocket|import\(", text, re.IGNORECASE)
    for _, attributes in found.elements:
        for name in ("src", "href", "action", "srcset", "data"):
            assert attributes.get(name, "data:").startswith("data:")
    assert {"link", "iframe", "object", "form", "base"}.isdisjoint(tag for tag, _ in found.elements)
    (policy,) = [a["content"] for a in found.of("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; img-src data:;")


def test_ids_are_unique_and_what_is_named_is_there(tmp_path):
    _, text, found = made(tmp_path)
    ids = [attributes["id"] for _, attributes in found.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    named = [a[k] for _, a in found.elements for k in ("for", "aria-labelledby") if k in a]
    assert named
    assert set(named) <= set(ids)
    script = text[text.rindex("<script>") :]
    assert set(re.findall(r'at\("(\w+)"\)', script)) <= set(ids)
    assert set(re.findall(r'getElementById\("(\w+)"\)', script)) <= set(ids)
    assert all(attributes.get("alt") for attributes in found.of("img"))
    assert all(a.get("aria-label") or a.get("role") != "img" for a in found.of("svg"))
    assert [attributes["lang"] for attributes in found.of("html")] == ["en"]


def test_the_page_tells_what_was_answered(tmp_path):
    estimates, _, found = made(tmp_path, used={"perception": "coco", "poses": "auto"})
    words = answer_in_words(estimates[-1])
    assert words[1:] in found.texts["header"]
    assert f"status is {estimates[-1].status}" in found.texts["header"]
    assert found.texts["h1"] == "Where is “door”?"
    for fact in ("perception", "coco", "auto", "version"):
        assert fact in found.texts["dl"]
    rows = [a["id"] for a in found.of("tr") if "id" in a]
    assert rows == [f"row{index}" for index in range(5)]
    for estimate, step in zip(estimates, shown(found), strict=True):
        assert answer_in_words(estimate) in step["said"]
        assert step["x"] == pytest.approx(0.5 - estimate.azimuth / (2 * np.pi), abs=1e-4)
        assert f"{np.degrees(estimate.azimuth):+.1f}".replace("-", "−") in found.texts["tbody"]
        picture = Image.open(io.BytesIO(base64.b64decode(step["picture"].partition(",")[2])))
        drawn = StepPainter(pages.WIDTH, bare=True).paint(PANORAMA, estimate).astype(int)
        assert np.abs(np.asarray(picture).astype(int) - drawn).mean() < 4
    assert "every frame was used" in found.texts["section"]


def test_the_note_is_that_of_the_camera(tmp_path):
    """The page has both; its style sheet shows the one of its class."""
    _, text, around = made(tmp_path)
    assert ".whole .ordinary,.ordinary .whole{display:none}" in text
    assert [attributes["class"] for attributes in around.of("body")] == ["whole"]
    assert [a["class"] for a in around.of("span")] == ["whole", "ordinary"]
    view, path = PerspectiveGrid(90, 160, np.radians(70)), tmp_path / "view.html"
    with BeliefPage(path, query="door") as page:
        page.add(np.zeros((90, 160, 3), np.uint8), turning(1)[0], grid=view)
    found = Reader(path.read_text(encoding="utf-8"))
    assert [attributes["class"] for attributes in found.of("body")] == ["ordinary"]
    assert shown(found)[0]["x"] is None, "the picture's columns are not those of a panorama"


@pytest.mark.parametrize("text", [EVIL, "$", "<!--", "\u2028", "ドア", "]]>"])
def test_words_from_outside_stay_words(tmp_path, text):
    path = tmp_path / "out.html"
    with BeliefPage(path, query=text, used={text: text}) as page:
        for index, estimate in enumerate(turning(2)):
            page.add(PANORAMA, estimate, name=f"{text}{index}", problem=text if index else None)
        page.notes.append(text)
    found = Reader(path.read_text(encoding="utf-8"))
    assert len(found.of("script")) == 2
    assert len(found.of("img")) == 1
    assert not [name for _, attributes in found.elements for name in attributes if name.startswith("on")]
    assert " ".join(text.split()) in found.texts["title"]
    assert text in found.texts["dd"]
    assert found.texts["ul"].count(text) == 3  # the note, and the frame's name and problem
    assert [step["name"] for step in shown(found)] == [f"{text}0", f"{text}1"]


def test_a_long_track_is_thinned_and_bounded_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(pages, "PICTURES", 4)
    monkeypatch.setattr(pages, "ROWS", 6)
    _, text, found = made(tmp_path, count=9)
    assert [step["row"] for step in shown(found)] == [0, 4, 8]
    assert "One of 4 frames has a picture (9 frames). The table has one of 2 frames." in text
    assert [a["id"] for a in found.of("tr") if "id" in a] == [f"row{index}" for index in (0, 2, 4, 6, 8)]
    assert [a["data-step"] for a in found.of("button") if "data-step" in a] == ["0", "1", "2"]


def test_a_page_of_the_busiest_pictures_is_at_most_8_mb():
    noise = np.random.default_rng(0).integers(0, 255, (560, 1120, 3), dtype=np.uint8)
    address = pages.as_address(noise)
    assert len(address) < 4 / 3 * pages.LARGEST + 100
    assert pages.PICTURES * len(address) < 7.5e6
    assert Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2]))).width < 1120


@pytest.mark.parametrize(
    ("error", "said"), [(KeyboardInterrupt(), "it was interrupted"), (RuntimeError("a <b> broke"), "a <b> broke")]
)
def test_a_run_that_does_not_end_leaves_its_page(tmp_path, error, said):
    path = tmp_path / "out.html"
    page = BeliefPage(path, query="door")
    with pytest.raises(type(error)), page:  # noqa: PT012
        page.add(PANORAMA, turning(1)[0], problem="it is dark")
        raise error
    found = Reader(path.read_text(encoding="utf-8"))
    assert f"The run did not end ({said})" in found.texts["li"]
    assert "frame 0: it is dark" in found.texts["li"]
    assert len(shown(found)) == 1


def test_what_cannot_be_written_is_refused(tmp_path):
    for name in ("out.txt", "out"):
        with pytest.raises(EagorError, match=r"wanted a page, \.html"):
            BeliefPage(tmp_path / name, query="door")
    with BeliefPage(tmp_path / "out.html", query="door"):
        pass  # without frames there is no page
    assert not list(tmp_path.iterdir())
    (tmp_path / "out.html").mkdir()
    page = BeliefPage(tmp_path / "out.html", query="door")
    page.add(None, turning(1)[0], stamp=1.0)
    with pytest.raises(TimeError, match="in order of time"):
        page.add(None, turning(1)[0], stamp=1.0)
    with pytest.raises(StorageError):
        page.close()
