"""What differs between the families of models, as data: no family has code of its own.

Nothing here imports torch or transformers, so that ``eagor doctor`` can print what could run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast

from eagor.errors import EagorError
from eagor.perception.vlm.boxes import Frame, Order

Fit = Literal["exact", "squash", "pad", "tiles"]
Extractor = Literal["attention", "boxes", "both", "mask", "views"]


@dataclass(frozen=True)
class Checkpoint:
    """A published checkpoint: its name on the hub, and its size in billions of parameters."""

    name: str
    billions: float

    @property
    def gigabytes(self) -> float:
        """Memory (1e9 bytes) that it takes in 16 bits, with a fifth added for what runs beside the weights.

        An estimate from the number of parameters; `benchmarks/vlm_latency.py` measures.
        """
        return 2.4 * self.billions


@dataclass(frozen=True)
class Served:
    """How a family is asked where it runs on a server, which tells nothing about it but its name.

    - `pattern`: regular expression that finds the family in lower-case names such as ``qwen2.5vl:7b``.
    - `cell`: pixels of one side of an image token; pictures are sent in multiples of it. `view`: of a square view.
    - `aspect`: width / height of a panorama as it is sent. Where processors bring everything to a square, some by
      cutting the sides off, the panorama is squeezed beforehand: cells are then twice as wide as high.
    - `frame`: coordinates that a family which was not trained to write boxes is asked for; `order` of them.
    """

    pattern: str
    cell: int
    view: int
    aspect: float = 2.0
    frame: Frame = "thousand"
    order: Order = "xyxy"


@dataclass(frozen=True)
class Dialogue:
    """How a conversation is written, for checkpoints that bring no template of their own.

    - `user`, `assistant`, `system`: what such a message becomes; ``{text}`` stands for its words (and pictures). An
      empty `system`: its words go before those of the first user.
    - `begin`: what stands before everything; `reply`: before the next reply; `picture`: for a picture, the family's
      placeholder in it.
    - `helper`: the words of the system message where nobody gives any; empty for no such message.
    """

    user: str
    assistant: str
    reply: str
    picture: str
    system: str = ""
    begin: str = ""
    helper: str = ""


def _chatml(picture: str, helper: str = "") -> Dialogue:
    parts = {role: f"<|im_start|>{role}\n{{text}}<|im_end|>\n" for role in ("system", "user", "assistant")}
    return Dialogue(**parts, reply="<|im_start|>assistant\n", picture=picture, helper=helper)


@dataclass(frozen=True)
class Family:
    """A family of models; `title` is the name that people know, `checkpoints` are some published ones.

    - `model_types`: values of ``model_type`` in ``config.json`` that belong to it.
    - `fit`: how an image becomes what the model sees. ``exact``: resized to whole cells, any aspect; ``squash``: to the
      model's square; ``pad``: into the square, background around it; ``tiles``: cut into squares, and the whole once
      more, smaller, behind them. `pixels`: how many an image has at most, where the family leaves a choice.
    - `extractor`: how directions are read by default: ``attention``, ``boxes`` that it writes, ``both`` from one call,
      the ``mask`` that it paints, or ``views``: `per_view` in tangent views that cover the sphere.
    - `frame`: coordinates of the boxes that it was trained to answer with; None where it was not.
    - `type_ids`: the input that tells image tokens from text, without which the model runs and answers wrongly.
    - `placeholder`: what the checkpoint's chat template writes where an image goes; it becomes the `expansion`, in
      which the `image_token` is then repeated. `dialogue`: for checkpoints without a template.
    - `depth`: the layer whose attention is read by default, as a fraction of all layers. 22 of 28 for Qwen2.5-VL-7B
      and 14 of 32 for LLaVA-1.5-7B are published (Zhang et al., arXiv 2502.17422); the rest are not measured.
    - `localiser`: whether it locates things and cannot talk: boxes or masks come from heads of its own, not in words.
    - `served`: how it is asked on a server; None where servers of chats do not run it.
    """

    name: str
    model_types: tuple[str, ...]
    title: str
    fit: Fit
    extractor: Extractor
    checkpoints: tuple[Checkpoint, ...]
    per_view: Extractor = "attention"
    frame: Frame | None = None
    type_ids: str | None = None
    placeholder: str = ""
    expansion: str = ""
    image_token: str = ""
    dialogue: Dialogue | None = None
    depth: float = 0.6
    pixels: int = 700 * 1400
    localiser: bool = False
    served: Served | None = None

    @property
    def template(self) -> str:
        """The prompt about one picture, with ``{text}`` for the question; empty where it holds no conversations."""
        if self.dialogue is None:
            return ""
        said = self.dialogue
        helper = said.system.replace("{text}", said.helper) if said.helper else ""
        return said.begin + helper + said.user.replace("{text}", said.picture + "{text}") + said.reply

    @property
    def view_pixels(self) -> int | None:
        """How many pixels a view has at most, by default; None where the family leaves no choice."""
        return self.served.view**2 if self.served else None

    def default(self, heads: str | None = None) -> Extractor:
        """The extractor where none is named; with a file of localisation heads one that reads them."""
        return "attention" if heads and self.extractor == "boxes" and not self.localiser else self.extractor

    @property
    def extractors(self) -> tuple[Extractor, ...]:
        """What can be asked of it."""
        if self.localiser:
            return (self.per_view, "views")
        return ("attention", "boxes", "both", "views") if self.frame else ("attention", "views")


_QWEN_IMAGE = "<|vision_start|><|image_pad|><|vision_end|>"

FAMILIES: tuple[Family, ...] = (  # vision-language models first
    Family(
        name="qwen2_5_vl",
        model_types=("qwen2_5_vl",),
        title="Qwen2.5-VL",
        fit="exact",
        extractor="boxes",
        frame="pixels",
        type_ids="mm_token_type_ids",
        placeholder="<|image_pad|>",
        expansion="<|image_pad|>",
        image_token="<|image_pad|>",
        dialogue=_chatml(_QWEN_IMAGE, "You are a helpful assistant."),
        depth=22 / 28,
        served=Served(r"qwen[\W_]?2[._]?5[\W_]?vl", cell=28, view=560),
        checkpoints=(
            Checkpoint("Qwen/Qwen2.5-VL-3B-Instruct", 3.75),
            Checkpoint("Qwen/Qwen2.5-VL-7B-Instruct", 8.29),
            Checkpoint("Qwen/Qwen2.5-VL-72B-Instruct", 73.4),
        ),
    ),
    Family(
        name="qwen3_vl",
        model_types=("qwen3_vl", "qwen3_vl_moe"),
        title="Qwen3-VL",
        fit="exact",
        extractor="boxes",
        frame="thousand",
        type_ids="mm_token_type_ids",
        placeholder="<|image_pad|>",
        expansion="<|image_pad|>",
        image_token="<|image_pad|>",
        dialogue=_chatml(_QWEN_IMAGE),
        depth=22 / 28,
        pixels=704 * 1408,
        served=Served(r"qwen[\W_]?3[._]?5|qwen[\W_]?3[\W_]?vl", cell=32, view=576),
        checkpoints=(
            Checkpoint("Qwen/Qwen3-VL-2B-Instruct", 2.13),
            Checkpoint("Qwen/Qwen3-VL-4B-Instruct", 4.44),
            Checkpoint("Qwen/Qwen3-VL-8B-Instruct", 8.77),
        ),
    ),
    Family(
        name="gemma3",
        model_types=("gemma3",),
        title="Gemma 3",
        fit="squash",
        extractor="views",
        type_ids="token_type_ids",
        placeholder="<start_of_image>",
        expansion="\n\n<start_of_image><image_soft_token><end_of_image>\n\n",
        image_token="<image_soft_token>",
        dialogue=Dialogue(
            user="<start_of_turn>user\n{text}<end_of_turn>\n",
            assistant="<start_of_turn>model\n{text}<end_of_turn>\n",
            reply="<start_of_turn>model\n",
            picture="<start_of_image>",
            begin="<bos>",
        ),
        pixels=896 * 896,
        served=Served(r"gemma[\W_]?3", cell=56, view=896, aspect=1.0, order="yxyx"),
        checkpoints=(Checkpoint("google/gemma-3-4b-it", 4.3), Checkpoint("google/gemma-3-12b-it", 12.2)),
    ),
    Family(
        name="llava",
        model_types=("llava",),
        title="LLaVA-1.5",
        fit="pad",
        extractor="attention",
        placeholder="<image>",
        expansion="<image>",
        image_token="<image>",
        dialogue=Dialogue(
            user="USER: {text} ",
            assistant="ASSISTANT: {text}</s>",
            reply="ASSISTANT:",
            picture="<image>\n",
            system="{text} ",
        ),
        depth=14 / 32,
        pixels=336 * 336,
        served=Served(r"llava[\W_]?(?:v?1[._]?[56]|7b|13b|hf|\Z)", cell=14, view=336, aspect=1.0, frame="unit"),
        checkpoints=(Checkpoint("llava-hf/llava-1.5-7b-hf", 7.06), Checkpoint("llava-hf/llava-1.5-13b-hf", 13.4)),
    ),
    Family(
        name="janus",
        model_types=("janus",),
        title="Janus-Pro",
        fit="pad",
        extractor="attention",
        placeholder="<image_placeholder>",
        expansion="<begin_of_image><image_placeholder><end_of_image>",
        image_token="<image_placeholder>",
        dialogue=Dialogue(
            user="<|User|>: {text}\n\n",
            assistant="<|Assistant|>: {text}<|end▁of▁sentence|>",
            reply="<|Assistant|>:",
            picture="<image_placeholder>\n",
            system="{text}\n\n",
        ),
        pixels=384 * 384,
        served=Served(r"janus", cell=16, view=384, aspect=1.0, frame="unit"),
        checkpoints=(
            Checkpoint("deepseek-community/Janus-Pro-1B", 2.1),
            Checkpoint("deepseek-community/Janus-Pro-7B", 7.4),
        ),
    ),
    Family(
        name="internvl",
        model_types=("internvl",),
        title="InternVL",
        fit="tiles",
        extractor="boxes",
        frame="thousand",
        placeholder="<IMG_CONTEXT>",
        expansion="<img><IMG_CONTEXT></img>",
        image_token="<IMG_CONTEXT>",
        dialogue=_chatml("<IMG_CONTEXT>\n"),
        pixels=448 * 896,
        served=Served(r"internvl", cell=28, view=448),
        checkpoints=(Checkpoint("OpenGVLab/InternVL3-2B-hf", 2.1), Checkpoint("OpenGVLab/InternVL3-8B-hf", 7.9)),
    ),
    Family(
        name="owlv2",
        model_types=("owlv2",),
        title="OWLv2",
        fit="pad",
        extractor="views",
        per_view="boxes",
        localiser=True,
        checkpoints=(
            Checkpoint("google/owlv2-base-patch16-ensemble", 0.155),
            Checkpoint("google/owlv2-large-patch14-ensemble", 0.438),
        ),
    ),
    Family(
        name="grounding_dino",
        model_types=("grounding-dino", "mm-grounding-dino"),
        title="Grounding DINO",
        fit="exact",
        extractor="boxes",
        per_view="boxes",
        localiser=True,
        checkpoints=(
            Checkpoint("IDEA-Research/grounding-dino-tiny", 0.172),
            Checkpoint("IDEA-Research/grounding-dino-base", 0.233),
        ),
    ),
    Family(
        name="clipseg",
        model_types=("clipseg",),
        title="CLIPSeg",
        fit="squash",
        extractor="views",
        per_view="mask",
        localiser=True,
        checkpoints=(Checkpoint("CIDAS/clipseg-rd64-refined", 0.151),),
    ),
)


def chosen(name: str, family: Family, option: str) -> Extractor:
    """`name` as an extractor of the family; `option` is for errors. Raises `EagorError`, which lists them."""
    if name not in family.extractors:
        raise EagorError(f"{option} = {name!r}; for {family.title} it can be {', '.join(family.extractors)}")
    return cast(Extractor, name)


def family_of(config: Mapping[str, Any] | Any, source: str) -> Family:
    """The family of a model's configuration (an object or the read ``config.json``); `source` is for errors.

    Raises `EagorError`, which lists the families, for any other.
    """
    kind = config.get("model_type") if isinstance(config, Mapping) else getattr(config, "model_type", None)
    for family in FAMILIES:
        if kind in family.model_types:
            return family
    known = ", ".join(f"{family.title} ({', '.join(family.model_types)})" for family in FAMILIES)
    raise EagorError(
        f"{source} holds a model of type {kind!r}, which cannot be read here; known are {known}. Other models can be "
        "served and reached as endpoint:MODEL@URL"
    )
