"""What reading directions from a vision-language model costs, in multiples of a plain call of the same model.

    python benchmarks/vlm_latency.py [--model qwen2_5_vl_7b] [--device cuda] [--answer 50] [--repeats 7] [--pixels N]

Random weights at real sizes: what a model answers does not matter here, how long it takes does. A plain call is
``generate()`` under scaled dot-product attention: image, question, and an answer of so many tokens (two boxes take
about 50). The contestants take turns; the table gives the fastest runs (other work on the machine only adds) and their
ratio to the plain call's. On a CPU choose ``--model reduced``; ratios there say little about a GPU, where decoding is
bound by the memory's bandwidth and reading the image by arithmetic.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import common
import numpy as np
import torch
import transformers
from tokenizers import Tokenizer, decoders, models, pre_tokenizers, trainers

from eagor.perception.transformers.heads import Heads
from eagor.perception.transformers.inputs import pictures, typed
from eagor.perception.transformers.language import LanguageModel
from eagor.perception.vlm import FAMILIES, GENERAL, ask_boxes, ask_presence

# Hidden size, layers, heads, key-value heads, intermediate size; and of the vision tower hidden size, layers, heads,
# intermediate size. From the published configurations (Bai et al., arXiv 2502.13923, table 1).
SIZES = {
    "qwen2_5_vl_7b": ((3584, 28, 28, 4, 18944), (1280, 32, 16, 3420)),
    "reduced": ((768, 12, 12, 4, 2048), (384, 8, 6, 1024)),
}
VOCABULARY = {"qwen2_5_vl_7b": 152_064, "reduced": 32_000}
SPECIALS = ["<|im_end|>", "<|im_start|>", "<|vision_start|>", "<|vision_end|>", "<|image_pad|>", "<|video_pad|>"]
QUERIES = ["red chair", "the blue sofa", "fridge", "a small white table", "green plant", "lamp", "sink", "grey bed"]


def tokenizer() -> Any:
    """A byte-level tokenizer that knows the words of our prompts: they have about as many tokens as real ones."""
    raw = Tokenizer(models.BPE())
    raw.pre_tokenizer = pre_tokenizers.Sequence(
        [pre_tokenizers.Digits(individual_digits=True), pre_tokenizers.ByteLevel(add_prefix_space=False)]
    )
    raw.decoder = decoders.ByteLevel()
    alphabet = pre_tokenizers.ByteLevel.alphabet()
    texts = [GENERAL, *(ask(query) for query in QUERIES for ask in (lambda q: ask_boxes(q, "pixels"), ask_presence))]
    raw.train_from_iterator(
        texts, trainers.BpeTrainer(vocab_size=2000, min_frequency=1, initial_alphabet=alphabet, show_progress=False)
    )
    made = transformers.PreTrainedTokenizerFast(tokenizer_object=raw, eos_token=SPECIALS[0], pad_token=SPECIALS[0])
    made.add_tokens(SPECIALS, special_tokens=True)
    return made


def build(size: str, device: str, dtype: torch.dtype, pixels: int) -> LanguageModel:
    """Qwen2.5-VL of a published size with random weights, on its device."""
    (hidden, layers, heads, groups, wide), (vision, depth, vision_heads, vision_wide) = SIZES[size]
    words = tokenizer()
    names = {"image": "<|image_pad|>", "video": "<|video_pad|>"}
    third = hidden // heads // 8
    config = transformers.Qwen2_5_VLConfig(
        text_config={
            "hidden_size": hidden, "num_hidden_layers": layers, "num_attention_heads": heads,
            "num_key_value_heads": groups, "intermediate_size": wide, "vocab_size": VOCABULARY[size],
            "max_position_embeddings": 32_768, "bos_token_id": None, "eos_token_id": words.eos_token_id,
            "pad_token_id": words.pad_token_id,
            "rope_parameters": {
                "rope_type": "default", "rope_theta": 1e6,
                "mrope_section": [hidden // heads // 2 - 3 * third, 3 * third // 2, 3 * third - 3 * third // 2],
            },
        },
        vision_config={
            "hidden_size": vision, "depth": depth, "num_heads": vision_heads, "intermediate_size": vision_wide,
            "out_hidden_size": hidden, "fullatt_block_indexes": list(range(depth // 4 - 1, depth, depth // 4)),
        },
        **{f"{kind}_token_id": words.convert_tokens_to_ids(name) for kind, name in names.items()},
    )  # fmt: skip
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        with torch.device(device):
            model = transformers.Qwen2_5_VLForConditionalGeneration(config).eval()
    finally:
        torch.set_default_dtype(before)
    model.generation_config.eos_token_id = None  # answers have the length that is asked for
    return LanguageModel(
        size, "random", FAMILIES[0], model, words, transformers.Qwen2VLImageProcessorPil(), pixels=pixels
    )


def contestants(language: LanguageModel, image: np.ndarray, answer: int) -> dict[str, Callable[[], object]]:
    """What is compared, by name; each call reads the image anew."""
    planned = language.plan(2.0)
    model, layers = language.model, language.layers
    question, presence = ask_boxes(QUERIES[0], "pixels"), ask_presence(QUERIES[0])

    def plain() -> object:
        tokens = language.prompt(question, planned)
        ids = torch.cat([tokens.prefix, tokens.suffix], dim=1).to(model.device)
        tensors = {key: value.to(model.device) for key, value in pictures([image], planned, language.processor).items()}
        tensors["pixel_values"] = tensors["pixel_values"].to(model.dtype)
        inputs = {"input_ids": ids, **tensors, **typed(language.family, ids, model.config.image_token_id)}
        return model.generate(**inputs, max_new_tokens=answer, min_new_tokens=answer, do_sample=False)

    def shared(texts: list[str], read: tuple[int, ...], tokens: int = 0, looks: int = 1) -> object:
        prefix = language.share([image] * looks, planned, language._cost())
        found: list[object] = []
        for text in texts:
            running = prefix.branch()
            logits, rows = running.ask(language.prompt(text, planned).suffix, read)
            found.append((language.yes(logits), {k: v.cpu() for k, v in rows.items()}))
            if tokens and text != GENERAL:
                found.append(running.decode(logits, tokens, ()))
        return found

    several = [GENERAL, *(ask_presence(query) for query in QUERIES)]
    return {
        "plain call (generate)": plain,
        "boxes (our decoding)": lambda: shared([question], (), answer),
        "map only (localisation heads)": lambda: shared([presence], layers),
        "map only, relative attention": lambda: shared([GENERAL, presence], layers),
        "boxes + map (localisation heads)": lambda: shared([question], layers, answer),
        "boxes + map, heads, two looks for the seam": lambda: shared([question], layers, answer, looks=2),
        f"map for {len(QUERIES)} queries, relative": lambda: shared(several, layers),
    }


def main() -> None:
    device = "cuda" if torch.cuda.is_available() else "cpu"
    parser = common.parser(__doc__, device=device, pixels=int, answer=50, repeats=7)
    parser.add_argument("--model", choices=SIZES)
    asked = parser.parse_args()
    gpu = asked.device.startswith("cuda")
    size = asked.model or ("qwen2_5_vl_7b" if gpu else "reduced")
    pixels = asked.pixels or (700 * 1400 if gpu else 224 * 448)
    torch.set_num_threads(1)
    torch.manual_seed(0)
    transformers.logging.set_verbosity_error()
    began = time.perf_counter()
    language = build(size, asked.device, torch.bfloat16 if gpu else torch.float32, pixels)
    layers = language.model.config.text_config.num_hidden_layers
    depth = round(language.family.depth * layers)
    language.heads = Heads(size, "qwen2_5_vl", ((depth - 2, 0), (depth - 1, 1), (depth, 2)), 3.0)  # three layers
    planned = language.plan(2.0)
    image = np.random.default_rng(0).integers(0, 256, size=(*planned.size, 3)).astype(np.uint8)
    weights = sum(one.numel() for one in language.model.parameters())
    where = torch.cuda.get_device_name() if gpu else "CPU, one thread"
    head = f"{size}, {weights / 1e9:.2f} billion parameters, {language.model.dtype}, {where}"
    print(f"{head}; {planned.size[1]} x {planned.size[0]} pixels, {planned.count} image tokens,", flush=True)
    print(f"answers of {asked.answer} tokens, torch {torch.__version__}, transformers {transformers.__version__}")
    print(f"(built in {time.perf_counter() - began:.0f} s)\n", flush=True)

    ways = contestants(language, image, asked.answer)
    times: dict[str, list[float]] = {name: [] for name in ways}
    with torch.inference_mode():
        for way in ways.values():  # not counted: kernels are chosen and caches filled
            way()
        for _ in range(asked.repeats):
            for name, way in ways.items():
                if gpu:
                    torch.cuda.synchronize()
                start = time.perf_counter()
                way()
                if gpu:
                    torch.cuda.synchronize()
                times[name].append(time.perf_counter() - start)
    plain = min(times["plain call (generate)"])
    print("| what | ms | of a plain call |\n|---|---|---|")
    for name, taken in times.items():
        print(f"| {name} | {1000 * min(taken):.0f} | {min(taken) / plain:.2f} |")


if __name__ == "__main__":
    main()
