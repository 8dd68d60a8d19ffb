"""What models on servers and models here share: reading answers, sizes, the seam, views, drawing."""

import contextlib
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from eagor.errors import AnswerError, GridError, ImageError
from eagor.grids import ErpGrid, PatchGrid, PerspectiveGrid, tangent_views
from eagor.perception.vlm import SERVED, ask_boxes, boxes_schema, exact_size, family_of
from eagor.perception.vlm.answers import Box, parse_boxes, parse_presence
from eagor.perception.vlm.perception import plan_view, project_to_sphere
from eagor.sources.panorama import cut
from eagor.sphere import angular_distance, direction, unit, world_R_body

SIDES = {"pixels": (896, 448), "thousand": (1000, 1000), "percent": (100, 100), "unit": (1, 1)}  # across, down
SIZE = (448, 896)
TAU = 2 * math.pi


def mean_direction(response: np.ndarray, grid) -> np.ndarray:
    mean = ((response * grid.weights)[..., None] * grid.directions).sum(axis=(0, 1))
    return mean / np.linalg.norm(mean)


# --- boxes: what was printed is read ---------------------------------------------------------------------------------


@st.composite
def boxes(draw):
    """Whole corners in thousandths, as x0, y0, x1, y1."""
    x0, y0 = draw(st.integers(0, 990)), draw(st.integers(0, 990))
    # Of a size: boxes within one pixel would be fractions.
    return x0, y0, draw(st.integers(max(x0 + 1, 10), 1000)), draw(st.integers(y0 + 1, 1000))


LABEL = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=12)
WRITTEN = st.lists(st.tuples(boxes(), LABEL), min_size=1, max_size=4, unique_by=lambda entry: entry[0])


def printed(entries, frame: str, order: str, key: str = "bbox_2d") -> list[dict]:
    across, down = SIDES[frame]
    found = []
    for (x0, y0, x1, y1), label in entries:
        numbers = [x0 / 1000 * across, y0 / 1000 * down, x1 / 1000 * across, y1 / 1000 * down]
        numbers = [int(n) if n == int(n) and frame != "unit" else n for n in numbers]
        numbers = numbers if order == "xyxy" else [numbers[1], numbers[0], numbers[3], numbers[2]]
        found.append({key: numbers, "label": label})
    return found


@given(WRITTEN, st.sampled_from([*SIDES]), st.sampled_from(["xyxy", "yxyx"]), st.integers(0, 5))
@settings(deadline=None)
def test_what_was_printed_is_read(entries, frame, order, wrapping):
    data = printed(entries, frame, order)
    text = [
        json.dumps(data),
        "```json\n" + json.dumps(data, indent="\t") + "\n```",
        "Here you are: " + json.dumps(data, ensure_ascii=False) + " - anything else?",
        json.dumps({"objects": data}),
        repr(data),
        "<think>Hm, [0, 0, 1, 1]?</think>" + json.dumps(data)[:-1] + ",",  # a comma too many, and no end
    ][wrapping]
    found = parse_boxes(text, frame, SIZE, order)
    assert len(found) == len(entries)
    for box, (corners, _) in zip(found, entries, strict=True):
        assert (box.x0, box.y0, box.x1, box.y1) == pytest.approx([c / 1000 for c in corners], abs=1e-9)
        assert box.score == 1


@pytest.mark.parametrize(
    "text",
    [
        "[100, 200, 300, 400]",
        "The chair is at (100, 200), (300, 400) in the image.",
        "chair(100,200),(300,400)",
        "<ref>chair</ref><box>[[100, 200, 300, 400]]</box>",
        "<|object_ref_start|>chair<|object_ref_end|><|box_start|>(100,200),(300,400)<|box_end|>",
        '{"chair": [100, 200, 300, 400]}',
        "{'bbox': [100, 200, 300, 400], 'label': 'chair'}",
        "{bbox_2d: [100, 200, 300, 400], label: chair}",
        '{"Bounding Box": {"x_min": 100, "y_min": 200, "x_max": 300, "y_max": 400}}',
        '{"x": 100, "y": 200, "width": 200, "height": 200}',
        '[{"bbox_2d": [[100, 200], [300, 400]]}]',
        '[{"bbox_2d": "[100, 200, 300, 400]"}]',
        '[{"bbox_2d": [300, 400, 100, 200]}]',  # corners swapped
        '[{"box_2d": [400, 300, 200, 100]}]',
        '[{"bbox_2d": [100, 200, 300, 400]}, {"bbox_2d": [100, 200, 300, 400]}]',  # said twice
        '[{"bbox_2d": [100, 200, 300, 400], "label": "chair"}, {"bbox_2d": [100, 2',  # cut off
        '[{"bbox_2d": [100, 200, 300, 400], "label": "cha',
        '[{"bbox_2d": [100, 200, 300, 400]}, {"bbox_2d": [5000, 6000, 7000, 8000]}]',
        '[{"bbox_2d": [100, 200, 300, 400]}, {"bbox_2d": [500, 600, 500, 800]}]',  # the second has no area
        "[0.1, 0.2, 0.3, 0.4]",  # fractions, though thousandths were wanted
        "The model thinks</think>[100, 200, 300, 400]",
        "[1e2, +200, 300.0, 4.0E2]",
        "<object><name>chair</name><bndbox><xmin>100</xmin><ymin>200</ymin><xmax>300</xmax><ymax>400</ymax></bndbox>",
        '<box x1="100" y1="200" x2="300" y2="400"/>',
        "<ref>a chair</ref><bbox>100 200 300 400</bbox>",
        "chair 1: 100, 200, 300, 400",
        "The chair (it's red): left = 100, top = 200, right = 300 and bottom = 400.",
        "chair<loc_100><loc_200><loc_300><loc_400>",
        '[{"box_2d": [200, 100, 400, 300]}]',  # Gemini's key: y first, whoever writes it
        "◁think▷[10, 20, 60, 90]? No.◁/think▷[100, 200, 300, 400]",
        "<Thinking>[10, 20, 60, 90]</Thinking>Perhaps [5, 6, 70, 80].</think><answer>[100, 200, 300, 400]</answer>",
        "Is it [10, 20, 60, 90]? No: <|begin_of_box|>[[100, 200, 300, 400]]<|end_of_box|>",
        '[{"bbox_2d": [0, 0, 0, 0]}, {"bbox_2d": [100, 200, 300, 400]}]',
        "left: 10%, top: 20 %, right: 30%, bottom: 40%",
        "[10%, 20%, 30%, 40%]",
        "椅子在（100，200），（300，400）。",
        '{"Top Left": [100, 200], "bottom-right": [300, 400]}',
        '{"box": "(100, 200), (300, 400)"}',
        # what four numbers are may be said beside them
        "[ymin, xmin, ymax, xmax] = [200, 100, 400, 300]",
        '{"bbox_yxyx": [200, 100, 400, 300]}',
        "<box_2d>200, 100, 400, 300</box_2d>",
        '{"bbox_xywh": [100, 200, 200, 200]}',
        '{"bbox": [100, 200, 200, 200], "format": "xywh"}',
        "[200, 300, 200, 200] (cx, cy, w, h)",
        '{"cx": 200, "cy": 300, "w": 200, "h": 200}',
        '{"center": {"x": 200, "y": 300}, "width": 200, "height": 200}',
        # polygons, ranges, signs
        '{"polygon": [[100, 200], [300, 250], [250, 400], [120, 390]]}',
        "(100, 200), (300, 200), (300, 400), (100, 400)",
        "[100, 200, 300, 200, 300, 400, 100, 400]",
        '{"x": [100, 300], "y": [200, 400]}',
        '[{"bbox_2d": ["100", "200", "300", "400"]}]',
        "[100px, 200px, 300px, 400px]",
        "[100、200、300、400]",
        "[100, 200, 300, 400, 0.9, 56]",
        # other lists, and what is taken back
        '{"color_rgba": [255, 0, 0, 255], "bbox_2d": [100, 200, 300, 400]}',
        '{"bbox_2d": [100, 200, 300, 400], "mask": "data:image/png;base64,iVBOR[1,2,3,4]w0KG"}',
        '[{"bbox_2d": [1, 2, 90, 80], "label": "none"}, {"bbox_2d": [100, 200, 300, 400], "label": "chair"}]',
        "Answer: [1, 2, 90, 80]\n**Final answer:** [100, 200, 300, 400]",
        "Like this: [1, 2, 90, 80]\nAnswer: [100, 200, 300, 400]",
        "Perhaps [1, 2, 90, 80], so \\boxed{[100, 200, 300, 400]}",
        "<final_answer>[100, 200, 300, 400]</final_answer>, not [1, 2, 90, 80]",
        # other marks of thoughts
        "<|START_THINKING|>[1, 2, 90, 80]<|END_THINKING|>[100, 200, 300, 400]",
        "<|channel>thought\n[1, 2, 90, 80]<channel|>[100, 200, 300, 400]",
        "<scratchpad>Or <draft>[1, 2, 90, 80]</draft> [5, 6, 70, 80]?</scratchpad>[100, 200, 300, 400]",
        '<think mode="deep">[1, 2, 90, 80]</think >[100, 200, 300, 400]',
        "&lt;think&gt;[1, 2, 90, 80]&lt;/think&gt;[100, 200, 300, 400]<explanation>[1, 2, 90, 80]</explanation>",
    ],
)
def test_ways_of_writing_one_box(text):
    (box,) = parse_boxes(text, "thousand", SIZE)
    assert (box.x0, box.y0, box.x1, box.y1) == pytest.approx((0.1, 0.2, 0.3, 0.4), abs=6e-4)  # <loc_100>: 0.1 to 0.101


@pytest.mark.parametrize(
    "text",
    [
        '{"lamp": [[100, 200, 300, 400], [500, 500, 600, 600]], "red stool": [[1, 2, 30, 40]]}',
        '{"lamp": {"bbox": [100, 200, 300, 400]}, "red_stool": {"bbox": [500, 500, 600, 600], "score": 0.5}}',
        "- label: lamp\n  bbox: [100, 200, 300, 400]\n- label: red stool\n  bbox: [500, 200, 600, 400]",
        "<ref>lamp</ref><box>[[100, 200, 300, 400]]</box><ref>red stool</ref><box>[[500, 500, 600, 600]]</box>",
        "1. **lamp**: (100, 200, 300, 400)\n2. a red stool: (500, 500, 600, 600)",
        "<object><name>lamp</name><xmin>1</xmin><ymin>2</ymin><xmax>30</xmax><ymax>40</ymax></object>",
        "{label: lamp, bbox: [100, 200, 300, 400]}",
        '{"objects": {"lamp": [{"bbox": [100, 200, 300, 400]}]}}',
        '{"detections": {"boxes": [[100, 200, 300, 400]]}}',
    ],
)
def test_what_stands_before_a_box_names_it(text):
    """Else a lamp would count as the stool that was asked for."""
    names = [each.label.removeprefix("a ").replace("_", " ") for each in parse_boxes(text, "thousand", (1000, 1000))]
    lamps = 2 if "400], [500" in text else int("lamp" in text)
    assert names == (["lamp"] * lamps + ["red stool"] * ("stool" in text) or [""])


def test_semicolons_part_boxes():
    first, second = parse_boxes("chairs [[100,200,300,400;010,020,030,040]]", "thousand", SIZE)
    assert (first.x0, first.y1, second.x0, second.y1) == pytest.approx((0.1, 0.4, 0.01, 0.04))
    (whole,) = parse_boxes("[0%, 0%, 100%, 100%]", "thousand", SIZE)
    assert (whole.x0, whole.y0, whole.x1, whole.y1) == pytest.approx((0, 0, 1, 1))


@pytest.mark.parametrize(
    ("text", "frame", "order"),
    [
        ('<point x="20.0" y="30.0" alt="a chair (red)">a chair</point>', "percent", "xyxy"),
        ("<point>20, 30</point>", "percent", "xyxy"),
        ('{"point_2d": [200, 300], "label": "chair"}', "thousand", "xyxy"),
        ('[{"point": [300, 200], "label": "chair"}]', "thousand", "yxyx"),
        ('{"points": [{"x": 0.2, "y": 0.3}]}', "thousand", "xyxy"),
        ('<points coords="1 1 200 300">chair</points>', "percent", "xyxy"),
        ("x: 200, y: 300", "thousand", "yxyx"),
    ],
)
def test_a_point_is_a_small_box(text, frame, order):
    (box,) = parse_boxes(text, frame, SIZE, order)
    assert ((box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2) == pytest.approx((0.2, 0.3))
    assert box.x1 - box.x0 == box.y1 - box.y0 == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("text", "score"),
    [
        ('[{"bbox_2d": [1, 2, 3, 4], "score": 0.8}]', 0.8),
        ('[{"bbox_2d": [1, 2, 3, 4], "confidence": "85%"}]', 0.85),
        ("[[1, 2, 3, 4, 0.7]]", 0.7),
        ('[{"bbox_2d": [1, 2, 3, 4], "score": "high"}]', 1.0),
        ('[{"bbox_2d": [1, 2, 3, 4], "score": -3}]', 1.0),
    ],
)
def test_written_scores(text, score):
    (box,) = parse_boxes(text, "thousand", SIZE)
    assert box.score == pytest.approx(score)


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        "```json\n[]\n```",
        "{}",
        '{"objects": []}',
        "None",
        "null",
        "No.",
        "There is no red chair in the image.",
        "There are no chairs.",
        "There isn't any red chair.",
        "The image does not contain a red chair.",
        "The image doesn\N{RIGHT SINGLE QUOTATION MARK}t show one.",
        "I cannot see a red chair.",
        "A red chair is not visible.",
        "No red chair was found here.",
        "<think>Maybe at [1, 2, 3, 4]</think>[]",
        "[[0, 0, 0, 0]]",
        '{"x1": 0, "y1": 0, "x2": 0, "y2": 0}',
        '{"bbox_2d": null, "label": "red chair"}',
        '{"present": false}',
        "[-1, -1, -1, -1]",
        "图中看不到椅子。",
        "画面に椅子は見当たりません。",
        "의자가 보이지 않습니다.",
        "No se ve ninguna silla.",
        "Il n’y a aucune chaise ici.",
        "Der Stuhl ist nicht zu sehen.",
        "Nella foto non ci sono sedie.",
        "Não vejo cadeiras.",
        "Стул не найден.",
        "Nie widać krzesła.",
        "Ik zie geen stoel.",
        "Sandalye bulunamadı.",
        "Det finns ingen stol.",
        "لا توجد كراسي",
        "N/A",
        "0 objects found.",
        "Red chair: not visible",
        "A kitchen with a table, but no red chair.",
        "This picture lacks a red chair.",
        '{"status": "not_found"}',
        '[{"label": "no red chair"}]',
        '{"found": false, "bbox": [100, 200, 300, 400]}',
        '[{"bbox_2d": [0, 0, 1000, 1000], "label": "none"}]',
        '[{"bbox_2d": [100, 200, 300, 400], "confidence": 0.0}]',
        "<loc_0><loc_0><loc_0><loc_0>",
        "<points></points>",
        "图中无红色椅子。",
        "検出できませんでした。",
        "찾지 못했습니다.",
        "Ich kann den Stuhl nicht finden.",
        "Não consegui encontrar.",
        "Я не вижу стула.",
        "На зображенні немає стільця.",
        "Žádná židle.",
        "Ei löytynyt.",
        "Δεν υπάρχει καρέκλα.",
        "Nincs szék a képen.",
    ],
)
def test_ways_of_saying_that_there_is_none(text):
    assert parse_boxes(text, "pixels", SIZE) == []


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("The red chair is on the left.", "on the left"),
        ("No problem! The chair is by the window.", "No problem"),
        ("", "''"),
        ("[1, 2, 3]", "wanted boxes"),
        ("<think>[1, 2, 3, 4] or", "allow more tokens"),
        ('[{"bbox_2d": [100, 200, 30', "cut off"),
        ("没问题，椅子在桌子旁边。", "椅子"),
        ("Kein Problem: links.", "links"),
        ("◁think▷ [1, 2, 3, 4] oder", "allow more tokens"),
        ("It spans x: 30%-50% and y: 40% to 80%.", "wanted boxes"),
        ("[300, 400, 100, 200]", "wrong order.*x, y, width, height"),
        ("[100, 200, 100, 200]", "no area.*x, y, width, height"),
        ("No chair is visible; [100, 200, 300, 400] is the closest.", "that there is none, and boxes"),
        ("[[10.5, 20.0, 30.0, 40.0], [5, 6, 70.2, 80]]", "count percents"),
        (f"[100, 200, 300, {'9' * 400}]", "outside the frame"),
        ("Is it [1, 2, 90, 80]? No, wait: [100, 200, 300, 400].", "takes boxes back"),
        ("No doubt: it stands in the corner.", "wanted boxes"),
        ("The chair does not have arms; it is at the left.", "wanted boxes"),
        ("椅子在左边,没有靠背。", "椅子"),
        ("La chaise n'est pas loin de la table.", "wanted boxes"),
        ("[1200, 1300, 1400, 1500]", "outside the frame 'thousand'"),
        ("[100, 200, 5000, 400]", "outside the frame"),
    ],
)
def test_unreadable_answers(text, says):
    with pytest.raises(AnswerError, match=says):
        parse_boxes(text, "thousand", SIZE)


def test_pixels_are_those_of_the_picture_that_the_model_saw():
    assert parse_boxes("[448, 112, 672, 224]", "pixels", (448, 896)) == [Box(0.5, 0.25, 0.75, 0.5)]
    assert parse_boxes("[448, 112, 672, 224]", "pixels", (896, 1792)) == [Box(0.25, 0.125, 0.375, 0.25)]
    with pytest.raises(AnswerError, match="does this model count its pixels"):
        parse_boxes("[[448, 112, 672, 224], [1500, 112, 1672, 224], [9, 9, 99, 9999]]", "thousand", (896, 1792))


@given(st.text(st.sampled_from("[](){}\"':,.-0123456789 eabox_2d<>/\\\n#"), max_size=80) | st.text(max_size=60))
@settings(deadline=None, max_examples=300)
def test_only_our_errors_escape_from_any_answer(text):
    try:
        found = parse_boxes(text, "thousand", SIZE, "xyxy", [(piece, -0.5) for piece in text])
    except AnswerError:
        found = []
    for box in found:
        assert 0 <= box.x0 < box.x1 <= 1
        assert 0 <= box.y0 < box.y1 <= 1
        assert 0 <= box.score <= 1
    with contextlib.suppress(AnswerError):
        assert 0 <= parse_presence(text) <= 1


def test_deep_and_long_answers_take_no_forever():
    for text in ("[" * 50_000, "{'a':" * 20_000, "[1," * 20_000, '"' * 50_000, "((1,2)" * 5000, "1" * 90_000 + "px"):
        with pytest.raises(AnswerError):
            parse_boxes(text, "thousand", SIZE)


@pytest.mark.parametrize("times", [1, 2, 3, 5000])
def test_a_key_written_again_and_again_holds_all(times):
    boxes = [[index, 10, index + 20, 50] for index in range(times)]
    text = "{" + ", ".join(f'"bbox_2d": {box}' for box in boxes) + "}"
    found = parse_boxes(text, "pixels", (100, 10_000))
    assert [[round(box.x0 * 10_000), 10, round(box.x1 * 10_000), 50] for box in found] == boxes


@pytest.mark.parametrize(
    "text",
    [
        "I'm sorry, but I can't see images.",
        "There is no image attached to your message.",
        "I don't see an image in this conversation. Please upload one.",
        "I do not have the ability to see pictures.",
        "As a text-based assistant, I cannot detect objects.",
        "The image did not load; I cannot see it.",
        "The picture is too blurry, I cannot find anything.",
        "没有收到图片,请重新上传。",
        "画像が添付されていません。",
        "Ich kann keine Bilder sehen.",
        "No puedo ver imágenes.",
    ],
)
def test_a_model_that_saw_no_picture_did_not_look_in_vain(text):
    with pytest.raises(AnswerError, match="vision-language model"):
        parse_boxes(text, "thousand", SIZE)
    with pytest.raises(AnswerError):
        parse_presence(text)
    with pytest.raises(AnswerError):
        parse_presence(text, [("No", -0.1), ("Yes", -3.0)])


# --- token probabilities ---------------------------------------------------------------------------------------------


def test_the_score_is_the_decision_times_the_leading_digits():
    pieces = [("```json\n", -5.0), ("[\n\t", -0.3), ("{", -0.2), ('"bbox_2d": [', -5.0)]
    pieces += [("1", -0.1), ("00, ", -5.0), ("2", -0.2), ("00, ", -5.0), ("3", -0.3), ("00, ", -5.0), ("4", -0.4)]
    pieces += [("00]}", -5.0), (",\n\t", -0.7), ('{"', -0.1), ('bbox_2d": [', 0.0)]
    pieces += [
        ("5", 0.0),
        ("00, ", 0.0),
        ("6", 0.0),
        ("00, ", 0.0),
        ("7", 0.0),
        ("00, ", 0.0),
        ("8", 0.0),
        ("00]}]", 0),
    ]
    text = "".join(piece for piece, _ in pieces)
    first, second = parse_boxes(text, "thousand", SIZE, tokens=pieces)
    assert first.score == pytest.approx(math.exp(-0.3 - 0.2 - 0.25))
    assert second.score == pytest.approx(math.exp(-0.7 - 0.1))
    assert [box.score for box in parse_boxes(text, "thousand", SIZE)] == [1, 1]


# --- presence --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "probability"),
    [
        ("Yes", 1),
        ("yes.", 1),
        ("**No**", 0),
        ("No, there is none", 0),
        ("<think>no</think> Yes", 1),
        ("Answer: yes", 1),
        ("是的。", 1),
        ("Nein.", 0),
        ("◁think▷no◁/think▷ Oui", 1),
        ('{"present": false}', 0),
        ("No doubt, yes.", 1),
        ("Yes or no? No.", 0),
        ("It is not easy to see, but yes.", 1),
        ("<analysis>no chair so far</analysis>Yes", 1),
        ("Thought: no, or?\nAnswer: yes", 1),
        ("存在", 1),
        ("見当たりません", 0),
    ],
)
def test_yes_and_no(text, probability):
    assert parse_presence(text) == probability


@pytest.mark.parametrize("text", ["I'm not sure.", "It is not clear.", "Maybe.", "yes/no", "Yes and no."])
def test_neither_yes_nor_no(text):
    with pytest.raises(AnswerError, match="wanted yes or no"):
        parse_presence(text)


@given(st.floats(0.01, 0.99), st.floats(0.001, 1))
def test_presence_is_the_share_of_yes(share, mass):
    first = [("Yes", math.log(share * mass)), ("No", math.log((1 - share) * mass)), ("The", -0.1)]
    assert parse_presence("Yes", first) == pytest.approx(share)
    split = [(" yes", math.log(share * mass / 2)), ("YES", math.log(share * mass / 2)), *first[1:]]
    assert parse_presence("Yes", split) == pytest.approx(share)


@given(st.floats(0.01, 1))
def test_what_is_not_listed_counts_for_the_other_side(probability):
    assert parse_presence("Yes", [("Yes", math.log(probability))]) == pytest.approx(probability)
    assert parse_presence("No", [("No", math.log(probability))]) == pytest.approx(1 - probability)


# --- prompts and styles ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["xyxy", "yxyx"])
@pytest.mark.parametrize("frame", [*SIDES])
def test_the_example_in_the_question_is_an_answer(frame, order):
    """What a model is shown is what we read, and its schema allows what it shows."""
    text = ask_boxes('red  "chair"\n', frame, order)
    assert "red 'chair'" in text
    assert "\n" not in text
    example = text[text.index("[{") : text.index("}]") + 2]
    numbers = text[text.index("for example [") + 12 : text.index("]. If") + 1]
    corners = example[example.index(": [") + 2 : example.index("],") + 1]
    assert len(parse_boxes(example.replace(corners, numbers), frame, SIZE, order)) == 1
    (key, *_) = json.loads(example.replace(corners, numbers))[0]
    assert boxes_schema(frame, order)["items"]["required"] == [key, "label"]


@pytest.mark.parametrize(
    ("name", "family"),
    [
        ("Qwen/Qwen2.5-VL-7B-Instruct", "qwen2_5_vl"),
        ("qwen2.5vl:7b", "qwen2_5_vl"),
        ("/models/qwen2_5_vl-72b-awq", "qwen2_5_vl"),
        ("Qwen/Qwen2-VL-2B-Instruct", "qwen2_vl"),
        ("Qwen/Qwen3-VL-30B-A3B-Instruct", "qwen3_vl"),
        ("qwen3-vl:8b", "qwen3_vl"),
        ("Qwen3.8-Flash", "qwen3_vl"),
        ("google/gemma-3-12b-it", "gemma3"),
        ("gemma3:4b", "gemma3"),
        ("llava-hf/llava-1.5-7b-hf", "llava"),
        ("llava:7b", "llava"),
        ("deepseek-community/Janus-Pro-7B", "janus"),
        ("OpenGVLab/InternVL3-8B-hf", "internvl"),
        ("models/gemini-2.5-pro", "gemini"),
        ("zai-org/GLM-4.5V", "glm_v"),
        ("moonshotai/Kimi-VL-A3B-Thinking", "kimi_vl"),
        ("openbmb/minicpm-v4.5:8b", "minicpm_v"),
        ("deepseek-ai/deepseek-vl2-tiny", "deepseek_vl2"),
        ("allenai/Molmo-7B-D-0924", "molmo"),
        ("vikhyatk/moondream2", "moondream"),
        ("microsoft/Florence-2-large", "florence2"),
        ("google/paligemma2-3b-mix-448", "paligemma"),
        ("Qwen/Qwen3-32B", "other"),
        ("gpt-4o", "other"),
        ("", "other"),
    ],
)
def test_families_are_known_by_name(name, family):
    style = family_of(name)
    assert style.name == family
    height, width = exact_size(style.cell, style.pixels, style.aspect)
    assert width == style.aspect * height
    assert exact_size(style.cell, style.view**2, 1.0) == (style.view, style.view)


def test_the_page_has_order_unit_and_source_of_every_family():
    page = Path(__file__).parents[2].joinpath("docs", "models.md").read_text(encoding="utf-8")
    for each in SERVED:
        row = f"| `{each.name}` | {ORDERS[each.order]} | {UNITS[each.frame]} | {each.source} |"
        assert each.source
        assert row in page, row


ORDERS = {"xyxy": "x first", "yxyx": "y first"}
UNITS = {"pixels": "pixels", "thousand": "0 to 1000", "percent": "0 to 100", "unit": "0 to 1"}


# --- sizes -----------------------------------------------------------------------------------------------------------


@given(st.sampled_from([14, 16, 28, 32, 56]), st.integers(28 * 28 * 2, 4_000_000))
def test_panoramas_are_exactly_two_to_one_and_as_large_as_allowed(cell, pixels):
    assume(pixels >= 2 * cell * cell)
    height, width = exact_size(cell, pixels)
    assert width == 2 * height
    assert height % cell == width % cell == 0
    assert height * width <= pixels < (height + cell) * (width + 2 * cell)


@pytest.mark.parametrize("bad", [(28, 700, 2.0), (0, 1000, 2.0), (28, 100_000, 0.0), (28, 100_000, math.nan)])
def test_sizes_that_cannot_be(bad):
    with pytest.raises(ImageError, match="allow more pixels"):
        exact_size(*bad)


# --- the seam --------------------------------------------------------------------------------------------------------


# --- views -----------------------------------------------------------------------------------------------------------

DIRECTION = st.tuples(st.floats(-math.pi, math.pi), st.floats(-math.pi / 2, math.pi / 2))
LAYOUTS = [(100, 10, 90), (60, 10, 90), (80, 10, 30)]
RANDOM = np.random.default_rng(0).normal(size=(20_000, 3))
RANDOM /= np.linalg.norm(RANDOM, axis=-1, keepdims=True)


@pytest.mark.parametrize(("hfov", "overlap", "reach"), LAYOUTS)
def test_views_cover_the_sphere_with_their_inner_parts(hfov, overlap, reach):
    views = tangent_views(64, *map(math.radians, (hfov, overlap, reach)))
    inner = [PerspectiveGrid(8, 8, math.radians(hfov - overlap + 0.2), view.body_R_view) for view in views]
    wanted = RANDOM[np.abs(np.degrees(np.arcsin(RANDOM[:, 2]))) <= reach]
    seen = np.any([view.project(wanted)[2] for view in inner], axis=0)
    assert seen.all()
    assert all(view.shape == (64, 64) for view in views)
    np.testing.assert_allclose(
        views[0].body_R_view[:, 0], direction(0.0, math.asin(views[0].body_R_view[2, 0])), atol=1e-9
    )


@pytest.mark.parametrize("bad", [(20, 10, 90), (170, 10, 90), (90, -1, 90), (90, 10, 0), (90, 10, 100), (90, 95, 90)])
def test_views_that_cannot_be(bad):
    with pytest.raises(GridError, match="wanted fields"):
        tangent_views(64, *map(math.radians, bad))


@given(DIRECTION)
@settings(deadline=None, max_examples=25)
def test_a_coarse_map_is_right_to_a_tenth_of_a_cell(where):
    """Cells as a model has them: 16 x 16 on a view of 100 degrees; the blob is two cells wide."""
    centre = direction(*where)
    views, grid = tangent_views(448), PatchGrid(48, 96)
    responses = [np.exp(20 * (view.resized(16, 16).directions @ centre - 1)) for view in views]
    response = project_to_sphere(responses, views, grid)
    assert math.degrees(float(angular_distance(mean_direction(response, grid), centre))) < 0.6


@given(st.floats(0, 1), st.integers(1, 9))
@settings(deadline=None, max_examples=20)
def test_constant_responses_stay_constant(value, cells):
    views = tangent_views(32)
    response = project_to_sphere([np.full((cells, cells), value)] * len(views), views, PatchGrid(12, 24))
    np.testing.assert_allclose(response, value, atol=1e-6)
    assert response.dtype == np.float32


@pytest.mark.parametrize(("yaw", "pitch"), [(0, 0), (90, 0), (180, 0), (-135, 40), (0, 90), (0, -90), (60, -60)])
def test_what_is_cut_shows_what_is_there(yaw, pitch):
    """A picture whose colours are its directions: each pixel of a view must show its own, at the poles and seam too."""
    for rows in (64, 256):  # coarser and finer than the view
        panorama = np.rint((ErpGrid(rows, 2 * rows).directions + 1) * 127.5).astype(np.uint8)
        view = PerspectiveGrid(64, 64, math.radians(100), world_R_body(math.radians(yaw), -math.radians(pitch)))
        (shown,) = cut(panorama, view)
        assert shown.dtype == np.uint8
        np.testing.assert_allclose(shown / 127.5 - 1, view.directions, atol=0.05 if rows == 64 else 0.025)


@pytest.mark.parametrize("side", [1e-300, 1e-15, 1e-7])
def test_boxes_of_no_size_to_speak_of_are_left_out(side):
    for flat in (f"[0.5, 0.5, {0.5 + side!r}, 0.6]", f"[0.0, 0.0, {side!r}, {side!r}]"):
        assert parse_boxes(f"[{flat}, [0.1, 0.2, 0.3, 0.4]]", "unit", SIZE) == [Box(0.1, 0.2, 0.3, 0.4)]
        with pytest.raises(AnswerError, match="no area"):
            parse_boxes(flat, "unit", SIZE)


@pytest.mark.parametrize("size", [(28, 56), (56, 56), (90, 64), (33, 47)])
def test_a_picture_of_another_shape_is_stretched_and_its_lens_with_it(size):
    """Directions of the image's pixels stay where they are, whatever shape the model wants."""
    grid = PerspectiveGrid(270, 480, math.radians(100), world_R_body(0.4, -0.2))
    image = np.full((270, 480, 3), 40, dtype=np.uint8)
    image[60:100, 300:340] = 250
    plan = plan_view(image, grid, size, (7, 9))
    ((picture, posed, _),) = plan.crops
    assert picture.shape == (*size, 3)
    assert plan.cells.shape == (7, 9)
    brightness = np.maximum(picture.max(axis=-1) - 60.0, 0)
    middle = unit(np.einsum("ij,ijk->k", brightness, posed.directions))
    wanted = unit(grid.directions[60:100, 300:340].reshape(-1, 3).mean(axis=0))
    assert angular_distance(middle, wanted) < posed.hfov / posed.width / 2
    for part in (posed, plan.cells):
        assert float(part.weights.sum()) == pytest.approx(float(grid.weights.sum()), rel=1e-6)
