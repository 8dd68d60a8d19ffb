"""Conversations of several turns, with pictures, with a local vision-language model.

The prompt follows the checkpoint's own template, otherwise the format that its family was trained on
(`eagor.perception.vlm.Dialogue`). Decoding is greedy (temperature 0).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from eagor.errors import EagorError
from eagor.media.panorama import checked_picture, resized
from eagor.perception.vlm import MAX_TOKENS, ChatReply, Family, Message


class LocalChat:
    """A `eagor.perception.vlm.Chat` with a model on this machine. Thread-safe; calls run one at a time.

    Arguments as of `eagor.perception.transformers.TransformersPerception`, except `pixels`: the most pixels of a
    picture; None for the limit of the checkpoint's processor. Gemma 3, LLaVA and Janus-Pro always see one square of
    fixed size.

    Raises `EagorError` if packages are missing, nothing can be loaded there, or the model's family cannot talk.
    """

    def __init__(
        self,
        model: str,
        max_tokens: int = MAX_TOKENS,
        pixels: int | None = None,
        revision: str | None = None,
        device: str | None = None,
        dtype: str | None = None,
    ) -> None:
        from eagor.perception.transformers.loading import counted, load_model, read_family

        self._max_tokens = counted("max_tokens", max_tokens, "512")
        _, family = read_family(model, revision)
        if family.dialogue is None:  # checked before weights are read
            raise EagorError(
                f"{model} is {family.title}, which locates things and cannot talk; wanted a vision-language model such "
                "as Qwen/Qwen2.5-VL-7B-Instruct (as a --perception of the agent eagor this one will do)"
            )
        how: dict[str, Any] = {"revision": revision, "device": device, "dtype": dtype}
        self._language: Any = load_model(model, extractor="attention", pixels=pixels, **how)

    def __call__(self, messages: Sequence[Message]) -> ChatReply:
        """The reply to `messages`, with its token counts.

        Raises `EagorError` if conversation and reply are longer than the model allows, `ImageError` for an image that
        is not a picture.
        """
        import torch

        from eagor.perception.transformers import inputs
        from eagor.perception.transformers.inference import share
        from eagor.perception.transformers.language import stops_of

        language, family = self._language, self._language.family
        config, processor = language.model.config, language.processor
        images = [checked_picture(image, "a picture") for message in messages for image in message.images]
        shapes = [image.shape[:2] for image in images]
        plans = [inputs.picture_plan(family, config, processor, shape, language.pixels) for shape in shapes]
        counts = [plan.layout.count for plan in plans]
        written = conversation(language.tokenizer, family, messages)
        prompt = inputs.tokens_of(language.tokenizer, family, written, config.image_token_id, counts)
        length = prompt.prefix.shape[1] + prompt.suffix.shape[1]
        self._check_length(length, counts)
        shown = zip(images, plans, strict=True)
        fed = [inputs.pictures([resized(image, plan.size)], plan, processor) for image, plan in shown]
        tensors = {name: torch.cat([one[name] for one in fed]) for name in (fed[0] if fed else ())}
        with language.lock, torch.inference_mode():
            prefix = share(language.model, family, prompt, tensors, 1, config.image_token_id)
            running = prefix.continued(last=True)
            logits = running.feed(prompt.suffix)
            answer = running.decode(logits, self._max_tokens, stops_of(language.model, language.tokenizer))
        text = language.tokenizer.decode(answer.ids[0], skip_special_tokens=True)
        return ChatReply(text.strip(), length, len(answer.ids[0]))

    def _check_length(self, length: int, counts: Sequence[int]) -> None:
        longest = getattr(self._language.model.config.get_text_config(), "max_position_embeddings", None)
        if longest is not None and length + self._max_tokens > longest:
            raise EagorError(
                f"the conversation has {length} tokens, {sum(counts)} of them for {len(counts)} pictures, and a reply "
                f"may have {self._max_tokens}; {self._language.name} takes {longest} together. Show it less of the "
                "conversation (--set window=2), fewer pixels (?pixels=...), or allow a shorter reply (?max_tokens=...)"
            )


def conversation(tokenizer: Any, family: Family, messages: Sequence[Message]) -> str:
    """`messages` as one text that ends where the reply begins, with the family's expansion in place of each picture.

    It uses the checkpoint's template if that supports pictures and accepts these messages.
    """
    from eagor.perception.transformers.inputs import own_template, templated

    said = [(message.role, [_plain(part, family) for part in message.parts()]) for message in messages]
    pictures = sum(part is None for _, parts in said for part in parts)
    if own_template(tokenizer, family) is not None:
        turns = [
            {
                "role": role,
                "content": [{"type": "image"} if part is None else {"type": "text", "text": part} for part in parts],
            }
            for role, parts in said
        ]
        written = templated(tokenizer, turns)
        words = [part.strip() for _, parts in said for part in parts if part is not None]
        if written.count(family.placeholder) == pictures and all(word in written for word in words):
            return written.replace(family.placeholder, family.expansion)
    return _by_family(family, said).replace(family.placeholder, family.expansion)


def _by_family(family: Family, said: Sequence[tuple[str, Sequence[str | None]]]) -> str:
    manner = family.dialogue
    assert manner is not None
    texts = [(role, "".join(manner.picture if part is None else part for part in parts)) for role, parts in said]
    if texts and texts[0][0] == "system" and not manner.system:
        (_, words), *texts = texts
        place = next((index for index, (role, _) in enumerate(texts) if role == "user"), None)
        if place is not None:
            texts[place] = "user", f"{words}\n\n{texts[place][1]}"
    elif manner.helper and not any(role == "system" for role, _ in texts):
        texts = [("system", manner.helper), *texts]
    forms = {"system": manner.system, "user": manner.user, "assistant": manner.assistant}
    return manner.begin + "".join(forms[role].replace("{text}", text) for role, text in texts) + manner.reply


def _plain(part: str | np.ndarray, family: Family) -> str | None:
    """Text without the tokens that stand for pictures; None for a picture."""
    if not isinstance(part, str):
        return None
    for token in {family.placeholder, family.image_token}:
        part = part.replace(token, token.strip("<|>"))  # written in the text, it would be taken for a picture
    return part
