"""Local models: every family, with small random models of the real architectures made here."""

import json
import math
import shutil
import sys
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
import torch
import transformers
import vlm_models

from eagor.errors import EagorError, QueryError
from eagor.evidence.calibration import Calibration
from eagor.grids import PatchGrid
from eagor.perception import check_perception, load, parse_options
from eagor.perception.calibrated import Labelled
from eagor.perception.transformers import TransformersPerception, inputs
from eagor.perception.transformers import language as language_module
from eagor.perception.transformers.heads import Heads, densities, fit_heads, read_heads, relative, saturated
from eagor.perception.transformers.inputs import Block, InputPlan
from eagor.perception.transformers.language import Run, capturing, full_layers
from eagor.perception.vlm import FAMILIES
from eagor.sources.panorama import resized
from eagor.sphere import angular_distance, direction

LANGUAGE, LOCALISERS = vlm_models.LANGUAGE, vlm_models.LOCALISERS
BOXES = ("qwen2_5_vl", "qwen3_vl", "internvl")
PIXELS = vlm_models.PIXELS
RADIUS = 0.3
languages = pytest.mark.parametrize("family", LANGUAGE)
# Where families differ in nothing but their sizes, three are enough: of two makers, and one with views in tiles.
SOME = ("qwen2_5_vl", "gemma3", "internvl")
some = pytest.mark.parametrize(
    "family", [one if one in SOME else pytest.param(one, marks=pytest.mark.slow) for one in LANGUAGE]
)


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="session")
def folders(tmp_path_factory):
    """Makes the model of a family once; its folder."""
    made = {}

    def folder(family):
        if family not in made:
            made[family] = vlm_models.make(family, tmp_path_factory.mktemp(family))
        return made[family]

    return folder


@pytest.fixture(scope="session")
def random_models(folders):
    """Loads the random language model of a family once."""
    loaded = {}

    def model(family):
        if family not in loaded:
            loaded[family] = vlm_models.language_model(folders(family), pixels=PIXELS.get(family))
        return loaded[family]

    return model


@pytest.fixture(scope="session")
def planted_models(folders):
    """Models with a planted head, and that head as localisation heads."""
    loaded = {}

    def model(family):
        if family not in loaded:
            language = vlm_models.language_model(folders(family), pixels=PIXELS.get(family), presence=False)
            vlm_models.plant(language)
            language.heads = Heads("planted", family, (vlm_models.HEAD,), 3.0)
            loaded[family] = language
        return loaded[family]

    return model


def perception_of(looker, extractor="attention", seam=True, per_view="attention"):
    """A perception around a model that is loaded already."""
    return TransformersPerception(looker, extractor, per_view, seam=seam)


def response_of(perception, panorama, query="red chair"):
    """The response map ``(h, w)`` of a look."""
    return np.asarray(perception(panorama, query).response)


def noise(rows=64, seed=0):
    coarse = np.random.default_rng(seed).integers(0, 256, size=(8, 16, 3))
    return np.kron(coarse, np.ones((rows // 8, rows // 8, 1))).astype(np.uint8)


def whole_feed(language, images, text):
    """What a single pass over image and question is fed, and the positions of the image tokens."""
    planned = language.plan(images[0].shape[1] / images[0].shape[0])
    images = [resized(image, planned.size, wrap=True) for image in images]
    tokens, image_token = language.prompt(text, planned), language.model.config.image_token_id
    ids = torch.cat([tokens.prefix, tokens.suffix], dim=1).expand(len(images), -1)
    feed = {"input_ids": ids, **inputs.pictures(images, planned, language.processor)}
    return {**feed, **inputs.typed(language.family, ids, image_token)}, tokens.columns, planned


@torch.inference_mode()
def eager_rows(language, feed, columns):
    """The last token's attention to the image in all layers ``{layer: (B, H, n)}``, from the full matrices."""
    model = language.model
    before = model.config.get_text_config()._attn_implementation
    model.set_attn_implementation("eager")
    try:
        attentions = model(**feed, output_attentions=True).attentions
    finally:
        model.set_attn_implementation("sdpa")
        model.set_attn_implementation({"text_config": before})
    return {layer: matrix[:, :, -1, columns] for layer, matrix in enumerate(attentions)}


# --- capture ---------------------------------------------------------------------------------------------------------


@languages
def test_captured_attention_is_that_of_eager(random_models, family):
    language = random_models(family)
    feed, columns, _ = whole_feed(language, [noise(), noise(seed=1)], "Is there a red chair?")
    layers = full_layers(language.model)
    with torch.inference_mode(), capturing(language.model, layers, columns) as capture:
        language.model(**feed)
    wanted = eager_rows(language, feed, columns)
    assert set(capture) == set(layers)
    for layer in layers:
        assert capture[layer].shape == wanted[layer].shape
        assert float((capture[layer] - wanted[layer]).abs().max()) < 1e-6
        assert float(wanted[layer].sum(dim=-1).min()) > 1e-3  # the image is looked at, so that this says something


@languages
def test_the_shared_prefix_answers_like_a_full_pass(random_models, family):
    language = random_models(family)
    images, texts = [noise(), noise(seed=1)], ["Is there a red chair?", "A much longer question about the blue ball."]
    layers = full_layers(language.model)
    planned = language.plan(2.0)
    with torch.inference_mode():
        shared = language.share(
            [resized(image, planned.size, wrap=True) for image in images], planned, language._cost()
        )
        for text in [*texts, texts[0]]:  # the first again: a question leaves the prefix as it was
            logits, rows = shared.branch().ask(language.prompt(text, planned).suffix, layers)
            feed, columns, _ = whole_feed(language, images, text)
            with capturing(language.model, layers, columns) as capture:
                full = language.model(**feed).logits[:, -1]
            torch.testing.assert_close(logits, full, atol=1e-5, rtol=1e-5)
            for layer in layers:
                torch.testing.assert_close(rows[layer], capture[layer], atol=1e-6, rtol=1e-5)


@some
def test_it_works_inside_generate_and_decodes_like_it(random_models, family):
    language = random_models(family)
    feed, columns, planned = whole_feed(language, [noise()], "Where is the red chair?")
    layers = full_layers(language.model)
    with torch.inference_mode():
        with capturing(language.model, layers, columns) as during:
            written = language.model.generate(**feed, max_new_tokens=6, min_new_tokens=6, do_sample=False)
        with capturing(language.model, layers, columns) as alone:
            language.model(**feed)
        running = language.share([resized(noise(), planned.size, wrap=True)], planned, language._cost())
        logits, rows = running.ask(language.prompt("Where is the red chair?", planned).suffix, layers)
        decoded = running.decode(logits, 6, stops=())
    assert [token for token, _ in decoded[0]] == written[0, -6:].tolist()
    assert all(log < 0 for _, log in decoded[0])
    for layer in layers:
        torch.testing.assert_close(during[layer], alone[layer], atol=1e-6, rtol=1e-5)
        torch.testing.assert_close(during[layer], rows[layer], atol=1e-6, rtol=1e-5)


def test_layers_with_a_window_are_not_read(random_models):
    assert full_layers(random_models("gemma3").model) == [vlm_models.LAYERS - 1]


# --- inputs that must not be forgotten -------------------------------------------------------------------------------


@pytest.mark.parametrize("family", ["qwen2_5_vl", "gemma3"])
def test_forgotten_type_ids_would_give_another_answer(random_models, family):
    """Of the families that need them, Qwen3-VL complains by itself."""
    language = random_models(family)
    feed, _, _ = whole_feed(language, [noise()], "Is there a red chair?")
    bare = {key: value for key, value in feed.items() if key != language.family.type_ids}
    language.model.model.rope_deltas = None
    with torch.inference_mode():
        bad, good = (language.model(**one).logits[:, -1] for one in (bare, feed))
    assert float((bad - good).abs().max()) > 1e-4


@pytest.mark.parametrize(
    ("family", "make"),
    [
        ("gemma3", lambda i, t: transformers.Gemma3Processor(i, t, image_seq_length=64)),
        ("llava", lambda i, t: transformers.LlavaProcessor(i, t, 7, "default", num_additional_image_tokens=1)),
        ("janus", lambda i, t: transformers.JanusProcessor(i, t, num_image_tokens=256)),
    ],
)
def test_inputs_are_those_of_the_processors(random_models, family, make):
    language = random_models(family)
    planned = language.plan(1.0)
    square = noise(112)[:, :112]
    text = "Is there a red chair?"
    processor = make(language.processor, language.tokenizer)
    written = language.family.prompt.replace("{text}", text)
    wanted = processor(text=written, images=[square], return_tensors="pt")
    ours = language.prompt(text, planned)
    assert torch.equal(torch.cat([ours.prefix, ours.suffix], dim=1), wanted["input_ids"])
    pictures = inputs.pictures([square], planned, language.processor)
    torch.testing.assert_close(pictures["pixel_values"], wanted["pixel_values"], atol=1e-5, rtol=0)


def test_padding_is_that_of_janus(random_models):
    language = random_models("janus")
    planned = language.plan(2.0)
    image = resized(noise(), planned.size)
    ours = inputs.pictures([image], planned, language.processor)["pixel_values"]
    theirs = language.processor(images=[image], return_tensors="pt")["pixel_values"]
    torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=0)


OWN = (
    "{% for message in messages %}<|im_start|>{{ message['role'] + '\n' }}{% for part in message['content'] %}"
    "{% if part['type'] == 'image' %}<|vision_start|><|image_pad|><|vision_end|>{% else %}{{ part['text'] }}"
    "{% endif %}{% endfor %}{{ '<|im_end|>\n' }}{% endfor %}{{ '<|im_start|>assistant\n' }}"
)


@pytest.mark.parametrize(
    ("template", "counts"),
    [
        (OWN, True),
        ("{% for message in messages %}{{ message['role'] + message['content'] }}{% endfor %}", False),  # words alone
        ("{{ raise_exception('one message at a time') }}", False),
        ("{% for message in messages %}{{ message.content", False),
    ],
)
def test_templates_of_checkpoints_count_where_they_know_images(random_models, monkeypatch, template, counts):
    language = random_models("qwen2_5_vl")
    helper = "<|im_start|>system\nYou are a helpful assistant.<|im_end|>\n"
    monkeypatch.setattr(language.tokenizer, "chat_template", template)
    ids = language.prompt("Is it red?", language.plan(2.0)).prefix[0].tolist()
    assert language.tokenizer.decode(ids).startswith(helper) is not counts
    spelled = language.prompt("What is <|image_pad|>?", language.plan(2.0))  # which stands for no picture
    assert len(spelled.columns) == language.plan(2.0).tokens


# --- where tokens look -----------------------------------------------------------------------------------------------


def test_padding_is_left_out_and_thumbnails_are_shared_out():
    padded = InputPlan((1, 1), (2, 4), (Block(4, 4, (0.0, -0.5, 1.0, 1.5)),))
    np.testing.assert_array_equal(padded.cells(np.arange(16.0)), np.arange(4.0, 12.0).reshape(2, 4))
    blocks = (Block(1, 1, (0, 0, 0.5, 1)), Block(1, 1, (0.5, 0, 1, 1)), Block(1, 1))
    tiles = InputPlan((1, 1), (1, 2), blocks)
    np.testing.assert_allclose(tiles.cells(np.array([1.0, 2.0, 4.0])), [[3.0, 4.0]])


@languages
@pytest.mark.parametrize("aspect", [2.0, 1.0, 1.5])
def test_plans_fit_their_models(random_models, family, aspect):
    language = random_models(family)
    planned = language.plan(aspect)
    tensors = inputs.pictures([np.zeros((*planned.size, 3), np.uint8)], planned, language.processor)
    with torch.inference_mode():
        features = language.model.model.get_image_features(**tensors, return_dict=True).pooler_output
    features = torch.cat(list(features)) if isinstance(features, tuple | list) else features
    assert features.reshape(-1, features.shape[-1]).shape[0] == planned.tokens
    assert planned.cells(np.ones(planned.tokens)).min() > 0


@some
def test_relative_attention_leaves_out_what_is_looked_at_anyway(random_models, monkeypatch, family):
    """A cell that soaks up attention whatever is asked, and one that the question alone draws attention to."""
    language = random_models(family)
    planned = language.plan(2.0)
    sink, target = (0, 0), (planned.shape[0] - 1, planned.shape[1] // 2)
    asked = []  # the question of no content comes first

    def last_row(query, *_):
        rows = np.ones(planned.tokens)
        for index in range(planned.tokens):
            cells = planned.cells(np.eye(1, planned.tokens, index)[0])
            rows[index] += 200 * cells[sink] + (20 * cells[target] if asked else 0)
        asked.append(len(rows))
        row = torch.tensor(rows / rows.sum() / 2, dtype=torch.float32)
        return row.expand(query.shape[0], query.shape[1], -1)

    monkeypatch.setattr(language_module, "last_row", last_row)
    response = response_of(perception_of(language, seam=False), noise(), "red chair")
    assert np.unravel_index(response.argmax(), response.shape) == target
    assert len(asked) == 2
    assert response[sink] < 0.1 * response[target]


# --- the whole path --------------------------------------------------------------------------------------------------


def peak_error(response, azimuth, elevation):
    """The angle from the highest cell to a direction, in half diagonals of a cell."""
    grid = PatchGrid(*response.shape)
    peak = grid.directions[np.unravel_index(response.argmax(), response.shape)]
    half = math.hypot(math.pi / grid.rows, 2 * math.pi / grid.cols) / 2
    return float(angular_distance(peak, direction(azimuth, elevation))) / half


@languages
def test_planted_weights_point_at_red_things(planted_models, family):
    perception = perception_of(planted_models(family))
    for azimuth, elevation in [(1.0, 0.0), (-2.0, 0.3), (0.2, -0.4), (2.6, -0.2)]:
        response = response_of(perception, vlm_models.marked(azimuth, elevation, seed=99), "red thing")
        assert peak_error(response, azimuth, elevation) < 1.05
        assert response.max() > 0.2
        assert np.median(response) < 0.25 * response.max()


@some
def test_the_seam_costs_nothing(planted_models, family):
    language = planted_models(family)
    _, cols = language.plan(2.0).shape
    middle = vlm_models.marked(math.pi / cols, 0.1, seed=98)
    behind = np.roll(middle, middle.shape[1] // 2, axis=1)  # the same thing, cut by the seam but for half a cell
    cut = vlm_models.marked(math.pi, 0.1, seed=98)
    perception = perception_of(language)
    ahead, back, seam = (response_of(perception, image, "red thing") for image in (middle, behind, cut))
    np.testing.assert_allclose(np.roll(ahead, cols // 2, axis=1), back, atol=2e-3)
    assert peak_error(seam, math.pi, 0.1) < 1.05
    assert peak_error(back, math.pi / cols + math.pi, 0.1) < 1.05


@pytest.mark.parametrize("extractor", ["attention", "views"])
def test_a_model_looks_at_its_usual_size(folders, extractor):
    """Without pixels of one's own."""
    perception = load(f"{folders('qwen2_5_vl')}?extractor={extractor}&seam=false")
    evidence = perception(noise(), "red chair")
    assert evidence.source["pixels"] == ([700, 1400] if extractor == "attention" else [560, 560])


@pytest.mark.parametrize("family", ["qwen2_5_vl", "gemma3", "internvl"])
def test_views_point_at_red_things_too(planted_models, family):
    language = planted_models(family)
    perception = perception_of(language, "views")
    for azimuth, elevation in [(math.pi, 0.0), (0.8, 1.2)]:
        evidence = perception(vlm_models.marked(azimuth, elevation, seed=97), "red thing")
        response = np.asarray(evidence.response)
        peak = evidence.grid.directions[np.unravel_index(response.argmax(), response.shape)]
        assert math.degrees(float(angular_distance(peak, direction(azimuth, elevation)))) < 25
        assert evidence.seen is None  # the views cover everything
        assert evidence.source["images"] == 6


@some
def test_several_queries_answer_like_one_at_a_time(random_models, family):
    perception = perception_of(random_models(family), seam=False)
    queries = ["red chair", "the blue ball", "fridge"]
    together = perception.observe(noise(), queries)
    for query, found in zip(queries, together, strict=True):
        np.testing.assert_allclose(found.response, response_of(perception, noise(), query), atol=1e-5)
    assert perception.observe(noise(), []) == []


@languages
def test_language_models_keep_the_contract(random_models, family):
    for extractor in ("attention", "views"):
        check_perception(perception_of(random_models(family), extractor), noise(), "red chair")


@languages
def test_evidence_tells_what_produced_it(folders, family):
    calibration = Calibration(floor=0.2, neutral=0.1)
    assert load(str(folders(family))).extractor == next(one for one in FAMILIES if one.name == family).extractor
    perception = load(
        f"{folders(family)}?extractor=attention&presence=false&pixels={PIXELS.get(family, 200_704)}",
        calibration=calibration,
    )
    evidence = perception(noise(), "red chair", stamp=3.5)
    source = evidence.source
    assert (evidence.stamp, evidence.calibration) == (3.5, calibration)
    assert source["model"] == str(folders(family))
    assert source["revision"].startswith("folder:")
    assert (source["family"], source["extractor"], source["images"]) == (family, "attention", 2)
    assert source["pixels"] == list(perception.loaded.plan(2.0).size)
    assert source["image_tokens"] == 2 * perception.loaded.plan(2.0).tokens
    assert source["prompt_tokens"] > 20
    assert source["answer_tokens"] == 0
    assert source["milliseconds"] > 0
    json.dumps(source)
    assert evidence.with_calibration(Calibration()).source == source


def test_the_probability_of_yes_scales_attention(random_models, monkeypatch):
    language = random_models("llava")
    asked = response_of(perception_of(language, seam=False), noise())
    monkeypatch.setattr(language, "presence", False)
    plain = response_of(perception_of(language, seam=False), noise())
    share = asked[plain > 0.01] / plain[plain > 0.01]
    assert 0 < share.min() <= share.max() < 1
    assert np.ptp(share) < 1e-4
    yes, no = (torch.full((1, language.model.config.get_text_config().vocab_size), -9.0) for _ in range(2))
    yes[0, language._yes[0]], no[0, language._no[0]] = 9.0, 9.0
    assert language.yes(yes)[0] > 0.99
    assert language.yes(no)[0] < 0.01


# --- boxes -----------------------------------------------------------------------------------------------------------


def writing(monkeypatch, language, answer, log=-0.1):
    """Make the model write ``answer(image)`` for each image that it is shown."""
    shown = []
    share = language.share
    monkeypatch.setattr(language, "share", lambda images, *rest: shown.append(images) or share(images, *rest))

    def decode(self, logits, most, stops):
        ids = [language.tokenizer.encode(answer(image), add_special_tokens=False) for image in shown[-1]]
        return [[(token, log) for token in one] for one in ids]

    monkeypatch.setattr(Run, "decode", decode)


def red_box(family):
    """The box around what is red in an image, as a family would write it."""

    def answer(image):
        red = (image[..., 0] > 200) & (image[..., 1] < 90)
        if not red.any():
            return "[]"
        rows, cols = np.flatnonzero(red.any(axis=1)), np.flatnonzero(red.any(axis=0))
        box = np.array([cols[0], rows[0], cols[-1] + 1, rows[-1] + 1], dtype=float)
        if family != "qwen2_5_vl":
            box *= 1000 / np.array([*image.shape[1::-1], *image.shape[1::-1]])
        return "```json\n" + json.dumps([{"bbox_2d": np.rint(box).astype(int).tolist(), "label": "red"}]) + "\n```"

    return answer


@pytest.mark.parametrize("family", BOXES)
@pytest.mark.parametrize("extractor", ["boxes", "views"])
def test_boxes_lead_to_their_directions(random_models, monkeypatch, family, extractor):
    language = random_models(family)
    writing(monkeypatch, language, red_box(family))
    perception = perception_of(language, extractor, per_view="boxes")
    for azimuth, elevation in [(1.0, 0.1), (-2.0, -0.3)]:
        evidence = perception(vlm_models.marked(azimuth, elevation, 0.2, seed=96), "red thing")
        (found,) = evidence.detections.directions
        assert math.degrees(float(angular_distance(found, direction(azimuth, elevation)))) < 4
        assert evidence.source["answer_tokens"] > 20
    assert len(perception(noise(seed=3) // 4 + 90, "red thing").detections) == 0


@pytest.mark.parametrize("family", BOXES)
def test_boxes_are_scored_by_the_probability_of_their_tokens(random_models, monkeypatch, family):
    language = random_models(family)
    scores = []
    for log in (-0.01, -0.3):
        with monkeypatch.context() as patch:
            writing(patch, language, red_box(family), log)
            image = vlm_models.marked(0.5, 0.0, 0.2, seed=96)
            scores += list(perception_of(language, "boxes", seam=False)(image, "red thing").detections.scores)
    assert len(scores) == 2
    assert 0.2 < scores[1] / scores[0] < 0.8
    assert 0.2 < scores[0] < 1


@pytest.mark.parametrize("family", [one for one in LANGUAGE if one not in BOXES])
def test_families_without_boxes_say_so(folders, family):
    with pytest.raises(EagorError, match=r"extractor = 'boxes'; for this model it can be (attention|views)"):
        TransformersPerception(str(folders(family)), extractor="boxes")


# --- attention to response -------------------------------------------------------------------------------------------


def test_relative_attention_is_one_where_the_question_made_no_difference():
    rng = np.random.default_rng(0)
    general = rng.random((2, 6, 12)) ** 6
    np.testing.assert_allclose(relative(general, general), 1)
    assert saturated(relative(general, general)).max() == 0
    more = general.copy()
    more[:, 4, 7] += 0.5
    ratio = relative(more, general)
    assert (ratio > 1).sum() == 2
    np.testing.assert_allclose(ratio[:, 4, 7], 1 + 0.5 / (general[:, 4, 7] + np.median(general, axis=(1, 2))))
    empty = np.zeros((1, 6, 12))
    asked = empty.copy()
    asked[0, 2, 3] = 1e-3
    assert np.isfinite(relative(asked, empty)).all()
    np.testing.assert_allclose(densities(empty), 1)


def test_the_scale_is_fixed_and_the_blur_goes_around():
    ratio = np.ones((1, 5, 8))
    ratio[0, 2, 0] = 9.0
    response = saturated(ratio, saturation=2.0)
    assert response[0, 2, 0] == pytest.approx(2 / (2 + 2))  # a quarter of the excess stays in the middle
    assert response[0, 2, -1] == response[0, 2, 1] > 0
    assert saturated(ratio, wrap=False)[0, 2, -1] == 0
    weaker = saturated((ratio - 1) / 2 + 1, saturation=2.0)
    assert weaker.max() < response.max()


# --- localisation heads ----------------------------------------------------------------------------------------------


@some
def test_localisation_heads_are_found_where_they_were_planted(planted_models, tmp_path, family):
    language = planted_models(family)
    places = [(0.5, 0.2), (-1.2, -0.3), (2.5, 0.1), (-2.8, 0.4)]
    examples = [
        Labelled(vlm_models.marked(*place, seed=i), "red thing", direction(*place), RADIUS)
        for i, place in enumerate(places)
    ]
    looks = [language.observe(example) for example in examples]
    found = perception_of(language).find_heads(iter(examples))
    assert found.heads[0] == vlm_models.HEAD
    assert (found.model, found.model_type) == (language.name, family)
    assert found == fit_heads(looks, language.name, family)
    found.write(tmp_path / "heads.json")
    assert read_heads(tmp_path / "heads.json") == found
    perception = perception_of(language)
    before, language.heads = language.heads, found
    try:
        response = response_of(perception, vlm_models.marked(-1.0, 0.0, seed=95), "red thing")
    finally:
        language.heads = before
    assert peak_error(response, -1.0, 0.0) < 1.05
    assert 0.2 < response.max() < 1
    blind = [replace(look, direction=-look.direction, radius=0.05) for look in looks]
    with pytest.raises(EagorError, match="no head of tiny"):
        fit_heads(blind, "tiny", family)


def test_heads_of_another_model_are_refused(folders, tmp_path):
    file = tmp_path / "heads.json"
    for heads in [[[40, 1]], [[2, 7]]]:
        file.write_text(json.dumps({"model": "big", "model_type": "llava", "heads": heads, "saturation": 2}))
        with pytest.raises(EagorError, match="found for big"):
            TransformersPerception(str(folders("llava")), heads=str(file))
    for text in ("{", "[]", '{"heads": []}', '{"model": "x", "model_type": "y", "heads": [], "saturation": 1}'):
        file.write_text(text)
        with pytest.raises(EagorError, match="heads"):
            read_heads(file)
    with pytest.raises(EagorError, match="cannot be read as localisation heads"):
        read_heads(tmp_path / "missing.json")


# --- detectors -------------------------------------------------------------------------------------------------------


DETECTORS = (*LOCALISERS, "yolos")


@pytest.mark.parametrize("family", DETECTORS)
def test_detectors_of_the_hub_keep_the_contract(folders, family):
    query = "cat" if family == "yolos" else "the red chair"
    check_perception(load(f"{folders(family)}?size=96&threshold=0.2"), noise(), query)


def planted_outputs(monkeypatch, model, place, score=3.0):
    """Make a detector's network answer with a box around `place` in its picture, fractions (x, y)."""
    forward = model.forward

    def planted(*args, **kwargs):
        out = forward(*args, **kwargs)
        x, y = place
        out.logits[:] = -9.0
        out.pred_boxes[:, 3] = torch.tensor([x, y, 0.08, 0.16])
        out.logits[:, 3, 0] = score
        if model.config.model_type == "yolos":
            out.logits[:, :, -1] = 2.0  # no object
            out.logits[:, 3, -1] = -9.0
        return out

    monkeypatch.setattr(model, "forward", planted)


@pytest.mark.parametrize("family", DETECTORS)
def test_planted_boxes_come_back_where_they_are_in_the_picture(folders, monkeypatch, family):
    """Whatever the processor does to the picture, and in each of several at once; with a label where there are any."""
    perception = load(f"{folders(family)}?size=96")
    detector, picture = perception.function, noise(96)[:, :96]
    for x, y in [(0.25, 0.5), (0.75, 0.375)]:
        with monkeypatch.context() as patch:
            planted_outputs(patch, detector.model, (x, y))
            found = detector.many([picture, picture[::-1]], "chair")
        for boxes, scores, labels in found:
            (left, top, right, bottom), (score,) = boxes[0], scores
            assert ((left + right) / 2, (top + bottom) / 2) == pytest.approx((96 * x, 96 * y), abs=2)
            assert score > 0.9
            assert labels == (["chair"] if family == "yolos" else None)


def test_scores_below_the_threshold_are_dropped(folders, monkeypatch):
    perception = load(f"{folders('owlv2')}?size=96&threshold=0.96")
    planted_outputs(monkeypatch, perception.function.model, (0.5, 0.5))  # the sigmoid of 3 is 0.953
    assert len(perception(noise(), "red chair").detections) == 0
    perception.function.threshold = 0.9
    assert len(perception(noise(), "red chair").detections) > 0


# --- loading ---------------------------------------------------------------------------------------------------------


def test_every_family_is_tested_and_described():
    assert {family.name for family in FAMILIES} == {*LANGUAGE}
    for family in FAMILIES:
        assert family.extractor in family.choices(False)[0][1:]
        assert family.prompt.count("{text}") == family.prompt.count(family.placeholder) == 1
        assert family.expansion.count(family.image_token) == 1


def test_options_are_read_from_the_name(folders):
    perception = load(f"{folders('qwen2_5_vl')}?extractor=attention&pixels=40000&seam=false&presence=false")
    assert (perception.extractor, perception.seam, perception.loaded.pixels) == ("attention", False, 40000)
    assert perception.loaded.presence is False
    assert parse_options("a=1&b=0.5&c=True&d=x-y") == {"a": 1, "b": 0.5, "c": True, "d": "x-y"}
    assert parse_options("revision=1234567&pixels=1234567") == {"revision": "1234567", "pixels": 1234567}
    assert parse_options("revision=12e4567&heads=2024") == {"revision": "12e4567", "heads": "2024"}
    assert parse_options("") == {}
    for text in ("a", "a=1&a=2", "=3", "a="):
        with pytest.raises(EagorError, match="name=value"):
            parse_options(text)


def test_what_cannot_be_loaded_says_why(folders, tmp_path, monkeypatch):
    folder = folders("llava")
    for written, says in {
        "colour=red": "'colour' is no key of a model here",
        "extractor=mask": "attention, views",
        "per_view=views": "it can be attention",
        "dtype=int8": r"float32\|bfloat16",
        "threshold=0.3": "'threshold' is no key of a model here",
    }.items():
        with pytest.raises(EagorError, match=says):
            load(f"{folder}?{written}")
    with pytest.raises(EagorError, match="'heads' is no key of a detector"):
        load(f"{folders('owlv2')}?heads=x.json")
    with pytest.raises(EagorError, match=r"no config\.json"):
        load(str(tmp_path) + "/")
    with pytest.raises(EagorError, match="there is no folder"):
        load("./nowhere/at/all")
    with pytest.raises(QueryError, match="hub names such as"):
        load("qwen")
    (tmp_path / "config.json").write_text('{"model_type": "bert"}')
    with pytest.raises(EagorError, match=r"'bert'.*Qwen2\.5-VL.*endpoint"):
        load(str(tmp_path))
    (tmp_path / "config.json").write_text((folder / "config.json").read_text())
    with pytest.raises(EagorError, match="cannot be loaded"):
        load(str(tmp_path))

    def offline(*_args, **_kwargs):
        raise OSError("no network")

    monkeypatch.setattr(transformers.AutoConfig, "from_pretrained", offline)
    with pytest.raises(EagorError, match=r"Qwen/Nothing.*no network"):
        load("Qwen/Nothing")
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(EagorError, match=r"pip install .*\[vlm\]'"):
        load(str(folder))


@pytest.mark.parametrize(
    "option",
    ["seam=no", "presence=maybe", "batch=0", "batch=many", "max_tokens=0", "pixels=lots", "device=one",
     "heads=nowhere.json", "batch=2.5", "batch=true", "device=meta"],
)  # fmt: skip
def test_options_without_a_meaning_are_refused_before_weights_are_read(folders, monkeypatch, option):
    def read(*_args, **_rest):
        raise AssertionError("weights were read")

    monkeypatch.setattr(transformers.AutoModelForImageTextToText, "from_pretrained", read)
    with pytest.raises(EagorError, match=option.partition("=")[0]):
        load(f"{folders('llava')}?{option}")


@pytest.mark.parametrize("file", ["config.json", "model.safetensors", "tokenizer.json", "preprocessor_config.json"])
@pytest.mark.parametrize("damage", ["missing", "cut"])
def test_a_damaged_checkpoint_is_named(folders, tmp_path, file, damage):
    folder = shutil.copytree(folders("llava"), tmp_path / "damaged")
    whole = (folder / file).read_bytes()
    if damage == "missing":
        (folder / file).unlink()
    else:
        (folder / file).write_bytes({"cut": whole[: len(whole) // 2]}[damage])
    with pytest.raises(EagorError, match=r"damaged' (has no config\.json|cannot be loaded)"):
        load(str(folder))


# --- a folder with a model is data: no code in it is run, and no pickle is opened ---


@pytest.fixture
def folder(folders, tmp_path):
    """A copy of a model's folder, to be changed."""
    return shutil.copytree(folders("qwen2_5_vl"), tmp_path / "model")


def test_pickled_weights_are_not_opened(folder, tmp_path):
    opened = tmp_path / "opened"

    class Bomb:
        def __reduce__(self):
            return (open, (str(opened), "w"))

    (folder / "model.safetensors").unlink()
    torch.save({"weight": Bomb()}, folder / "pytorch_model.bin")
    with pytest.raises(EagorError, match=r"cannot be loaded \(AutoModelForImageTextToText: OSError: .*safetensors"):
        load(str(folder))
    assert not opened.exists()


@pytest.mark.parametrize(
    ("file", "kind"),
    [
        ("config.json", "AutoConfig"),
        ("config.json", "AutoModelForImageTextToText"),
        ("tokenizer_config.json", "AutoTokenizer"),
        ("preprocessor_config.json", "AutoImageProcessor"),
    ],
)
def test_code_in_the_folder_is_not_run_nor_asked_for(folder, tmp_path, capsys, monkeypatch, file, kind):
    ran = tmp_path / "ran"
    (folder / "theirs.py").write_text(f"open({str(ran)!r}, 'w')\n")
    told = json.loads((folder / file).read_text())
    named = "theirs.Theirs"
    told["auto_map"] = {kind: [named, named] if kind == "AutoTokenizer" else named}
    (folder / file).write_text(json.dumps(told))
    monkeypatch.setattr("builtins.input", lambda *_: pytest.fail("it asks"))
    with suppress(EagorError):  # some kinds are of the library itself as well, and are then loaded from there
        load(str(folder))
    assert not ran.exists()
    assert capsys.readouterr().out == ""


def test_what_a_library_prints_is_no_result(folder, capsys, monkeypatch):
    read = transformers.AutoConfig.from_pretrained

    def talkative(*arguments, **options):
        print("Do you wish to run the custom code? [y/N]")
        return read(*arguments, **options)

    monkeypatch.setattr(transformers.AutoConfig, "from_pretrained", talkative)
    load(str(folder))
    out, err = capsys.readouterr()
    assert out == ""
    assert "custom code" in err
