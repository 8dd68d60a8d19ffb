"""H*Bench held to what its published environment does, and to plain implementations of the same arithmetic."""

import json
import math
import re
from pathlib import Path

import hstar_data
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor.errors import EagorError, FormatError, ImageError
from eagor.lab.tasks.hstar import (
    Action,
    View,
    middle_of,
    parse_action,
    render_view,
    submit_succeeds,
    window_of,
    without_cross,
)

SHARED = Path(__file__).parents[2] / ".." / "shared" / "bench_samples"
SUBMIT, PARSE = SHARED / "conformance_hstar_submit.json", SHARED / "conformance_hstar_parse.json"
angles = st.floats(-720, 720, allow_nan=False)


@pytest.mark.skipif(not SUBMIT.exists(), reason="the shared vectors are not here")
def test_success_is_what_the_published_environment_decides():
    vectors = json.loads(SUBMIT.read_text())["vectors"]
    different = 0
    for vector in vectors:
        item = {key: vector[key] for key in ("yaw", "pitch") if vector[key] is not None}
        assert [*map(list, window_of(item))] == [vector["window_yaw"], vector["window_pitch"]]
        official = submit_succeeds(item, *vector["submit"], "official")
        assert official == vector["success"], vector
        strict = submit_succeeds(item, *vector["submit"], "strict")
        assert official or not strict
        different += official != strict
    assert len(vectors) == 420
    assert different == 12  # all of them where a window crosses yaw 0


@pytest.mark.skipif(not PARSE.exists(), reason="the shared vectors are not here")
def test_replies_are_read_as_the_published_parser_reads_them():
    for vector in json.loads(PARSE.read_text()):
        text = vector.pop("text")
        assert vars(parse_action(text)) == vector, text


TAGS = ("<think>", "</think>", "<answer>", "</answer>")


def published(text):
    """Thought, actions and form of a reply by the patterns of the published parser (the default configuration)."""
    strict, loose = (
        r"<think>(.*?)</think>\s*<answer>(.*?)</answer>",
        r"(?:<think>(.*?)</think>)?.*?<answer>(.*?)</answer>",
    )
    text = text.replace("<image>", "")
    kept = re.match(rf"^\s*{strict}\s*$", text.strip(), re.DOTALL) is not None
    found = re.search(loose, text, re.DOTALL)
    thought, answer = (part or "" for part in found.groups()) if found else ("", "")
    for tag in TAGS:
        thought, answer = (part.replace(tag, "").strip() for part in (thought, answer))
    actions = [part.strip() for part in answer.split("|") if part.strip()]
    return {"think_content": thought, "actions": actions[:1], "format_correct": kept}


PIECES = (*TAGS, *TAGS, "submit(10,0)", " ", "|", "\n", "rotate(5,-5)", "a", "<", "<ans", "wer>", "<image>")


@settings(max_examples=1500)
@given(st.lists(st.sampled_from(PIECES), max_size=14).map("".join))
def test_replies_of_any_tags_are_read_as_the_published_parser_reads_them(text):
    assert vars(parse_action(text)) == published(text)


def test_a_model_that_repeats_itself_is_read_at_once():
    for loop in ("</think><answer>", "<answer>"):  # a quarter of an hour and more with the published patterns
        assert parse_action("<think>" + loop * 3000).actions == []


@pytest.mark.parametrize(
    ("text", "action"),
    [
        ("rotate(-45,0)", Action("rotate", -45, 0)),
        ("submit( 285 , +5 )", Action("submit", 285, 5)),
        ("rotate(30.5,0)", None),
        ("rotate(30)", None),
        ("Rotate(30,5)", None),
        ("rotate (30,5)", None),
        ("zoom(in)", None),
        ("", None),
    ],
)
def test_actions_are_whole_degrees_and_case_sensitive(text, action):
    assert parse_action(f"<answer>{text}</answer>").action == action


@given(angles, st.floats(0, 359), st.floats(-90, 90), st.floats(0, 90))
def test_windows_hold_their_middle_and_are_as_wide_as_the_tolerance(yaw, width, low, height):
    item = {"yaw": [yaw % 360, (yaw + width) % 360], "pitch": [low, min(90.0, low + height)]}
    middle = middle_of(item)
    assert submit_succeeds(item, *middle, "strict")
    assert submit_succeeds(item, middle[0] + 360, middle[1], "strict") == submit_succeeds(item, *middle, "strict")


def test_items_that_are_none_are_refused():
    for item in ({}, {"yaw": [1]}, {"yaw": [1, float("nan")], "pitch": [0, 1]}, {"yaw": "ab"}):
        with pytest.raises(FormatError, match="yaw"):
            submit_succeeds(item, 0, 0)
    with pytest.raises(EagorError, match="official or strict"):
        submit_succeeds({"yaw": [0, 10]}, 0, 0, "lenient")


def reference(image, yaw, pitch, rows):
    """The published view, written out in float64: rays, rotation, bilinear with wrap."""
    columns = rows // 9 * 16
    focal = columns / (2 * math.tan(math.radians(50)))
    j, i = np.meshgrid(np.arange(columns), np.arange(rows))
    rays = np.stack([(j - columns / 2) / focal, (i - rows / 2) / focal, np.ones(j.shape)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    a, b = math.radians(yaw), math.radians(pitch)
    lift = np.array([[1, 0, 0], [0, math.cos(b), -math.sin(b)], [0, math.sin(b), math.cos(b)]])
    turn = np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])
    x, y, z = np.moveaxis(rays @ (turn @ lift).T, -1, 0)
    height, width = image.shape[:2]
    u = (np.arctan2(x, z) / np.pi + 1) / 2 * width
    v = (np.arcsin(np.clip(y, -1, 1)) / np.pi + 0.5) * height
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    p, q = (u - left)[..., None], (v - top)[..., None]

    def at(row, column):
        return image[row % height, column % width].astype(float)

    upper = at(top, left) * (1 - p) + at(top, left + 1) * p
    return upper * (1 - q) + (at(top + 1, left) * (1 - p) + at(top + 1, left + 1) * p) * q


@pytest.mark.parametrize(("yaw", "pitch"), [(0, 0), (357, -40), (181, 90), (90, -90), (33, 12), (-30, 60)])
def test_views_are_the_published_ones_to_half_a_grey_level(yaw, pitch):
    rng = np.random.default_rng(5)
    rough = rng.integers(0, 256, (9, 20, 3)).astype(np.uint8)
    image = np.kron(rough, np.ones((17, 19, 1), dtype=np.uint8))  # 153 x 380, not 2:1, with hard edges
    found = render_view(image, yaw, pitch, 270, cross=False)
    assert found.shape == (270, 480, 3)
    off = np.abs(found - reference(image, yaw, pitch, 270))
    # float32 coordinates: a few parts in 1e5 of a pixel, times an edge of 255
    assert off.max() < 0.5 + 0.03
    assert (off > 0.501).mean() < 1e-3


def test_the_cross_is_filled_in_from_beside_it():
    slope = np.repeat(np.arange(180, dtype=np.uint8), 360 * 3).reshape(180, 360, 3)  # darker to the top
    for image, most in ((np.full((90, 180, 3), 77, dtype=np.uint8), 0), (slope, 1)):
        for resolution in (90, 270, 1080):
            with_cross, without = (render_view(image, 10, 5, resolution, cross=cross) for cross in (True, False))
            filled = without_cross(with_cross)
            assert np.abs(filled.astype(int) - without).max() <= most
            assert (filled == with_cross).all(axis=-1).sum() >= with_cross[..., 0].size - 41, "nothing else changed"
    with pytest.raises(ImageError, match="a view is"):
        without_cross(with_cross[..., 0])


@pytest.mark.parametrize(("yaw", "pitch"), [(0, 0), (215, -25), (90, 40)])
def test_the_grid_of_a_view_names_the_directions_that_its_pixels_show(yaw, pitch):
    image = hstar_data.panorama({"red": ([yaw + 8.0, yaw + 14.0], [pitch + 4.0, pitch + 10.0])}, 720, 1440)
    view = View(yaw, pitch)
    red = render_view(image, yaw, pitch, 270, cross=False)[..., 1] < 60
    from eagor.conventions import hstar_from_direction

    shown = view.grid(270).directions[red]
    yaws, pitches = hstar_from_direction(shown)
    assert abs((yaws.mean() - (yaw + 11) % 360 + 180) % 360 - 180) < 0.6
    assert abs(pitches.mean() - (pitch + 7)) < 0.6
    assert view.shows(shown).all()


def test_what_is_in_view():
    for view, share in ((View(0, 0), 1), (View(180, 0), 0), (View(50, 0), 0.5)):
        assert abs(view.share({"yaw": (350, 10), "pitch": (-5, 5)}) - share) < 0.2
    assert View(350, 80).after(Action("rotate", 30, 30)) == View(20, 90)
    assert View(10, -80).after(Action("rotate", -30, -30)) == View(340, -90)
