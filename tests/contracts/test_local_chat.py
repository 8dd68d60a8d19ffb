"""Local models that talk: conversations of several turns with pictures, by the tiny models of every family."""

import json

import numpy as np
import pytest
import torch
import transformers
import vlm_models
from transformers.models.qwen2_vl.image_processing_pil_qwen2_vl import smart_resize

from eagor.errors import EagorError, ImageError
from eagor.lab.agents.models import load_chat, release, shared_chat
from eagor.media.panorama import resized
from eagor.perception.transformers import LocalChat, conversation, inputs
from eagor.perception.vlm import FAMILIES, IMAGE, Message, nearest_size

pytestmark = pytest.mark.usefixtures("one_thread")
families = pytest.mark.parametrize("family", vlm_models.LANGUAGE)
OWN = (  # as the template of a checkpoint: other words around the turns than the family's
    "{% for message in messages %}<|im_start|>{{ message['role'] | upper }}\n{% for part in message['content'] %}"
    "{% if part['type'] == 'image' %}<|vision_start|><|image_pad|><|vision_end|>{% else %}{{ part['text'] }}"
    "{% endif %}{% endfor %}<|im_end|>\n{% endfor %}{% if add_generation_prompt %}<|im_start|>ASSISTANT\n{% endif %}"
)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Makes the model of a family once; its folder."""
    made = {}
    transformers.utils.logging.disable_progress_bar()

    def folder(family):
        if family not in made:
            made[family] = vlm_models.make(family, tmp_path_factory.mktemp(family))
        return made[family]

    return folder


@pytest.fixture(scope="module")
def chats(folders):
    """Loads the chat of a family once."""
    made = {}

    def chat(family):
        if family not in made:
            pixels = {"pixels": vlm_models.PIXELS[family]} if family in vlm_models.PIXELS else {}
            made[family] = LocalChat(str(folders(family)), max_tokens=8, **pixels)
        return made[family]

    return chat


def picture(seed, height=54, width=96):
    coarse = np.random.default_rng(seed).integers(0, 256, size=(6, 8, 3), dtype=np.uint8)
    return resized(coarse, (height, width))


def talk(*, first=0, second=1):
    """Two turns with a picture each, the second of another shape."""
    return [
        Message("system", "You look for things."),
        Message("user", f"Here is a view:\n{IMAGE}\nWhere is it?", (picture(first),)),
        Message("assistant", "Not here."),
        Message("user", f"And here:\n{IMAGE}\nIs it here?", (picture(second, 80, 80),)),
    ]


def whole(chat, messages):
    """What one pass over the whole conversation is fed."""
    language, family = chat._language, chat._language.family
    images = [image for message in messages for image in message.images]
    config, processor = language.model.config, language.processor
    plans = [inputs.picture_plan(family, config, processor, image.shape[:2], language.pixels) for image in images]
    text = conversation(language.tokenizer, family, messages)
    counts = [plan.layout.count for plan in plans]
    prompt = inputs.tokens_of(language.tokenizer, family, text, config.image_token_id, counts)
    ids = torch.cat([prompt.prefix, prompt.suffix], dim=1)
    fed = [inputs.pictures([resized(i, p.size)], p, processor) for i, p in zip(images, plans, strict=True)]
    tensors = {name: torch.cat([one[name] for one in fed]) for name in fed[0]}
    return {"input_ids": ids, **tensors, **inputs.typed(family, ids, config.image_token_id)}, text, counts


@families
def test_replies_are_those_of_generate_over_the_whole_conversation(chats, family):
    chat, messages = chats(family), talk()
    feed, _, counts = whole(chat, messages)
    language = chat._language
    with torch.inference_mode():
        written = language.model.generate(**feed, max_new_tokens=8, do_sample=False)[0, feed["input_ids"].shape[1] :]
    said = chat(messages)
    assert said.text == language.tokenizer.decode(written, skip_special_tokens=True).strip()
    assert said.prompt_tokens == feed["input_ids"].shape[1]
    assert said.completion_tokens in (len(written), len(written) - 1)  # the stop counts for generate
    assert len(counts) == 2
    assert chat(messages) == said  # nothing is left over from a conversation


@families
def test_every_picture_and_every_turn_is_heard(chats, family):
    """The next token's logits change with each of them: the reply of a random model may not."""
    chat, heard = chats(family), []
    hook = chat._language.model.lm_head.register_forward_hook(lambda _m, _i, out: heard.append(out[0, -1].clone()))
    found = []
    for messages in (talk(), talk(first=7), talk(second=7), [*talk()[:2], Message("assistant", "No"), talk()[3]]):
        heard.clear()
        chat(messages)
        found.append(heard[0])
    hook.remove()
    for other in found[1:]:
        assert float((other - found[0]).abs().max()) > 1e-5


@families
def test_words_alone_are_answered_too(chats, family):
    chat = chats(family)
    language = chat._language
    text = conversation(language.tokenizer, language.family, [Message("user", "Hello?")])
    begins = text.startswith(language.tokenizer.bos_token or "\0")
    ids = torch.tensor([language.tokenizer(text, add_special_tokens=not begins)["input_ids"]])
    with torch.inference_mode():
        types = inputs.typed(language.family, ids, language.model.config.image_token_id)
        written = language.model.generate(input_ids=ids, **types, max_new_tokens=8, do_sample=False)[0, ids.shape[1] :]
    said = chat([Message("user", "Hello?")])
    assert said.text == language.tokenizer.decode(written, skip_special_tokens=True).strip()


@families
def test_conversations_are_written_as_the_family_was_trained(chats, family):
    language = chats(family)._language
    known, messages = language.family, talk()
    text = conversation(language.tokenizer, known, messages)
    words = [message.text.partition(IMAGE) for message in messages]
    place = -1
    for part in [part for before, _, after in words for part in (before, after) if part]:
        assert text.index(part) > place  # everything, in its order
        place = text.index(part)
    assert text.count(known.image_token) == 2
    assert text.endswith(known.dialogue.reply)
    assert known.template.startswith(known.dialogue.begin)
    # What spells a picture's token stands for none.
    spelled = [Message("user", f"{IMAGE} and {known.image_token}, {known.placeholder}", (picture(0),))]
    assert conversation(language.tokenizer, known, spelled).count(known.image_token) == 1


def test_a_checkpoint_writes_as_its_own_template_says(chats):
    language = chats("qwen2_5_vl")._language
    tokenizer = language.tokenizer
    tokenizer.chat_template = OWN
    try:
        text = conversation(tokenizer, language.family, talk())
        assert text.startswith("<|im_start|>SYSTEM\nYou look for things.<|im_end|>\n<|im_start|>USER\nHere is")
        assert text.endswith("<|im_start|>ASSISTANT\n")
        assert "helpful" not in text
        # One that knows no pictures, and one that wants no system message, are not used.
        for refusing in (
            OWN.replace("<|vision_start|><|image_pad|><|vision_end|>", ""),
            "{% if messages[0]['role'] == 'system' %}{{ raise_exception('no system') }}{% endif %}" + OWN,
        ):
            tokenizer.chat_template = refusing
            assert "<|im_start|>system\nYou look" in conversation(tokenizer, language.family, talk())
    finally:
        tokenizer.chat_template = None


@pytest.mark.parametrize("shape", [(1080, 1920), (1080, 1919), (512, 1024), (30, 40), (3000, 5000), (28, 5000), (1, 1)])
def test_pictures_get_the_size_that_the_processor_gives_them(shape):
    for cell, least, most in ((28, 3136, 1003520), (28, 3136, 12845056), (32, 65536, 16777216)):
        assert nearest_size(cell, shape, least, most) == smart_resize(*shape, cell, least, most)
        rows, cols = nearest_size(cell, shape, least, most)
        assert rows % cell == cols % cell == 0
    with pytest.raises(ImageError, match="cells of 28"):
        nearest_size(28, shape, 0, 700)


def test_a_model_is_loaded_once_per_process(folders, monkeypatch):
    from eagor.perception.transformers import loading

    loads, really = [], loading.load_model
    monkeypatch.setattr(loading, "load_model", lambda name, **rest: loads.append(name) or really(name, **rest))
    spec = f"{folders('qwen2_5_vl')}?pixels=25088&max_tokens=2"
    release()
    assert shared_chat(spec) is shared_chat(spec)
    assert loads == [str(folders("qwen2_5_vl"))]
    release()
    assert shared_chat.cache_info().currsize == 0


def test_a_conversation_that_is_too_long_is_told_in_tokens(folders):
    chat = LocalChat(str(folders("llava")), max_tokens=3900)
    with pytest.raises(EagorError, match=r"512 of them for 2 pictures.*takes 4096 together.*--set window=2"):
        chat(talk())
    assert LocalChat(str(folders("llava")), max_tokens=8)(talk()).completion_tokens is not None


def test_what_cannot_talk_is_refused_before_weights_are_read(folders, tmp_path, monkeypatch):
    monkeypatch.setattr("eagor.perception.transformers.loading.load_model", lambda *_, **__: pytest.fail("it was read"))
    for family in vlm_models.LOCALISERS:
        with pytest.raises(EagorError, match="locates things and cannot talk"):
            load_chat(str(folders(family)))
    (tmp_path / "bert").mkdir()
    (tmp_path / "bert" / "config.json").write_text(json.dumps({"model_type": "bert"}))
    (tmp_path / "empty").mkdir()
    for spec, says in (
        (tmp_path / "nowhere", "there is no folder"),
        (tmp_path / "empty", "no config.json"),
        (tmp_path / "bert", "type 'bert', which cannot be read here"),
        (f"{folders('llava')}?colour=red", "options.*colour.*max_tokens"),
        (f"{folders('llava')}?max_tokens=0", "max_tokens = 0"),
    ):
        with pytest.raises(EagorError, match=says):
            load_chat(str(spec))


def test_pictures_have_to_be_pictures(chats):
    with pytest.raises(ImageError, match="a picture is float64"):
        chats("gemma3")([Message("user", IMAGE, (np.zeros((4, 4, 3)),))])


def test_families_that_talk_know_how():
    for family in FAMILIES:
        assert (family.dialogue is None) == family.localiser
