"""Small random models of the real architectures, saved with tokenizer and image processor as a hub folder would be."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import transformers
from tokenizers import Tokenizer, decoders, models, pre_tokenizers, processors

from eagor.grids import ErpGrid
from eagor.perception.transformers import load_model
from eagor.perception.transformers.inputs import InputPlan
from eagor.perception.transformers.language import LanguageModel
from eagor.sources.panorama import resized
from eagor.sphere import angular_distance, direction

LANGUAGE = ("qwen2_5_vl", "qwen3_vl", "gemma3", "llava", "janus", "internvl")
LOCALISERS = ("owlv2", "grounding_dino")
LAYERS = 3
PIXELS = {"qwen2_5_vl": 168 * 336, "qwen3_vl": 192 * 384, "internvl": 112 * 224}  # of small pictures
LOCAL = 0.06  # deviation of the vision towers' weights: small, so that a token is about its own place most of all

TEXT: dict[str, Any] = {
    "hidden_size": 32,
    "intermediate_size": 48,
    "num_hidden_layers": LAYERS,
    "num_attention_heads": 4,
    "num_key_value_heads": 2,
    "max_position_embeddings": 4096,
    "initializer_range": 0.2,
}


def tokenizer_with(specials: list[str], **roles: str) -> transformers.PreTrainedTokenizerFast:
    """One token per byte, and `specials`: no vocabulary to learn, and every text has its tokens."""
    alphabet = sorted(pre_tokenizers.ByteLevel.alphabet())
    raw = Tokenizer(models.BPE(vocab={letter: i for i, letter in enumerate(alphabet)}, merges=[]))
    raw.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    raw.decoder = decoders.ByteLevel()
    roles = {"pad_token": specials[0], "eos_token": specials[0], **roles}
    tokenizer = transformers.PreTrainedTokenizerFast(tokenizer_object=raw, **roles)
    tokenizer.add_tokens(specials, special_tokens=True)
    return tokenizer


def _sizes(tokenizer: Any, **changes: Any) -> dict[str, Any]:
    ids = {"pad_token_id": tokenizer.pad_token_id, "eos_token_id": tokenizer.eos_token_id, "bos_token_id": None}
    return {**TEXT, "vocab_size": len(tokenizer), **ids, **changes}


def _qwen2_5_vl() -> tuple[Any, Any, Any]:
    words = ["<|im_end|>", "<|im_start|>", "<|vision_start|>", "<|vision_end|>", "<|image_pad|>", "<|video_pad|>"]
    tokenizer = tokenizer_with(words)
    rope = {"rope_type": "default", "mrope_section": [2, 1, 1], "rope_theta": 1e6}
    vision = {"depth": 2, "hidden_size": 32, "intermediate_size": 48, "num_heads": 2, "out_hidden_size": 32}
    config = transformers.Qwen2_5_VLConfig(
        text_config=_sizes(tokenizer, rope_parameters=rope),
        vision_config={**vision, "fullatt_block_indexes": [1], "window_size": 56, "initializer_range": LOCAL},
        **_qwen_ids(tokenizer),
    )
    return (
        transformers.Qwen2_5_VLForConditionalGeneration(config),
        tokenizer,
        transformers.Qwen2VLImageProcessorPil(),
    )


def _qwen_ids(tokenizer: Any) -> dict[str, int]:
    names = {"image": "<|image_pad|>", "video": "<|video_pad|>"}
    ids = {f"{kind}_token_id": tokenizer.convert_tokens_to_ids(name) for kind, name in names.items()}
    edges = {
        f"vision_{edge}_token_id": tokenizer.convert_tokens_to_ids(f"<|vision_{edge}|>") for edge in ("start", "end")
    }
    return {**ids, **edges}


def _qwen3_vl() -> tuple[Any, Any, Any]:
    words = ["<|im_end|>", "<|im_start|>", "<|vision_start|>", "<|vision_end|>", "<|image_pad|>", "<|video_pad|>"]
    tokenizer = tokenizer_with(words)
    rope = {"rope_type": "default", "mrope_section": [2, 1, 1], "rope_theta": 5e6}
    vision = {"depth": 2, "hidden_size": 32, "intermediate_size": 48, "num_heads": 2, "out_hidden_size": 32}
    config = transformers.Qwen3VLConfig(
        text_config=_sizes(tokenizer, head_dim=8, rope_parameters=rope),
        vision_config={
            **vision, "deepstack_visual_indexes": [0], "num_position_embeddings": 64, "initializer_range": LOCAL
        },
        **_qwen_ids(tokenizer),
    )  # fmt: skip
    processor = transformers.Qwen2VLImageProcessorPil(
        patch_size=16, image_mean=[0.5, 0.5, 0.5], image_std=[0.5, 0.5, 0.5]
    )
    return transformers.Qwen3VLForConditionalGeneration(config), tokenizer, processor


def _gemma3() -> tuple[Any, Any, Any]:
    words = ["<eos>", "<bos>", "<start_of_turn>", "<end_of_turn>"]
    images = {"boi_token": "<start_of_image>", "eoi_token": "<end_of_image>", "image_token": "<image_soft_token>"}
    tokenizer = tokenizer_with([*words, *images.values()], bos_token="<bos>", extra_special_tokens=images)
    layers = ["sliding_attention"] * (LAYERS - 1) + ["full_attention"]
    config = transformers.Gemma3Config(
        text_config=_sizes(tokenizer, head_dim=8, layer_types=layers, sliding_window=256, query_pre_attn_scalar=8),
        vision_config={**_SIGLIP, "image_size": 112, "patch_size": 7},
        mm_tokens_per_image=64,
        boi_token_index=tokenizer.convert_tokens_to_ids("<start_of_image>"),
        eoi_token_index=tokenizer.convert_tokens_to_ids("<end_of_image>"),
        image_token_index=tokenizer.convert_tokens_to_ids("<image_soft_token>"),
    )
    model = transformers.Gemma3ForConditionalGeneration(config)
    # Zeros by default, so that images would have no effect.
    torch.nn.init.normal_(model.model.multi_modal_projector.mm_input_projection_weight, std=0.2)
    processor = transformers.Gemma3ImageProcessorPil(size={"height": 112, "width": 112})
    return model, tokenizer, processor


_SIGLIP: dict[str, Any] = {
    "hidden_size": 32, "intermediate_size": 48, "num_hidden_layers": 2, "num_attention_heads": 2,
    "initializer_range": LOCAL,
}  # fmt: skip


def _llava() -> tuple[Any, Any, Any]:
    tokenizer = tokenizer_with(["</s>", "<s>", "<image>"], bos_token="<s>")
    config = transformers.LlavaConfig(
        text_config=transformers.LlamaConfig(**_sizes(tokenizer)),
        vision_config=transformers.CLIPVisionConfig(**_SIGLIP, image_size=112, patch_size=7),
        image_token_index=tokenizer.convert_tokens_to_ids("<image>"),
        vision_feature_layer=-2,
        vision_feature_select_strategy="default",
    )
    processor = transformers.CLIPImageProcessorPil(size={"shortest_edge": 112}, crop_size={"height": 112, "width": 112})
    return transformers.LlavaForConditionalGeneration(config), tokenizer, processor


def _janus() -> tuple[Any, Any, Any]:
    words = ["<|end▁of▁sentence|>", "<|begin▁of▁sentence|>"]
    images = {"boi_token": "<begin_of_image>", "eoi_token": "<end_of_image>", "image_token": "<image_placeholder>"}
    tokenizer = tokenizer_with([*words, *images.values()], bos_token=words[1], extra_special_tokens=images)
    vision = {
        "hidden_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2, "image_size": 112, "patch_size": 7,
        "mlp_ratio": 1.5, "projection_dim": 32, "depth": 1, "num_image_tokens": 256, "initializer_range": LOCAL,
    }  # fmt: skip
    codes = {
        "embed_dim": 8, "num_embeddings": 16, "latent_channels": 8, "num_patches": 4, "base_channels": 32,
        "channel_multiplier": [1, 1], "num_res_blocks": 1, "projection_dim": 32, "image_token_embed_dim": 32,
    }  # fmt: skip
    config = transformers.JanusConfig(
        text_config=transformers.LlamaConfig(**_sizes(tokenizer)),
        vision_config=transformers.JanusVisionConfig(**vision),
        vq_config=transformers.JanusVQVAEConfig(**codes),
        image_token_id=tokenizer.convert_tokens_to_ids("<image_placeholder>"),
    )
    processor = transformers.JanusImageProcessorPil(size={"height": 112, "width": 112})
    return transformers.JanusForConditionalGeneration(config), tokenizer, processor


def _internvl() -> tuple[Any, Any, Any]:
    words = ["<|im_end|>", "<|im_start|>"]
    images = {
        "start_image_token": "<img>", "end_image_token": "</img>", "context_image_token": "<IMG_CONTEXT>",
        "video_token": "<video>",
    }  # fmt: skip
    tokenizer = tokenizer_with([*words, *images.values()], extra_special_tokens=images)
    config = transformers.InternVLConfig(
        text_config=transformers.Qwen2Config(**_sizes(tokenizer)),
        vision_config=transformers.InternVLVisionConfig(
            hidden_size=32, intermediate_size=48, num_hidden_layers=2, num_attention_heads=2, image_size=[56, 56],
            patch_size=[7, 7], initializer_range=LOCAL,
        ),
        image_token_id=tokenizer.convert_tokens_to_ids("<IMG_CONTEXT>"),
        image_seq_length=16,
    )  # fmt: skip
    processor = transformers.GotOcr2ImageProcessorPil(size={"height": 56, "width": 56})
    return transformers.InternVLForConditionalGeneration(config), tokenizer, processor


def _clip_tokenizer(longest: int) -> tuple[Any, dict[str, Any]]:
    """Texts between a first and a last token, the last with the highest id, as CLIP models expect; and their sizes."""
    tokenizer = tokenizer_with(["<pad>", "<first>", "<last>"], eos_token="<last>", bos_token="<first>")
    ids = [(name, tokenizer.convert_tokens_to_ids(name)) for name in ("<first>", "<last>")]
    tokenizer.backend_tokenizer.post_processor = processors.TemplateProcessing(
        single="<first> $A <last>", special_tokens=ids
    )
    text = {
        "vocab_size": len(tokenizer), "hidden_size": 32, "intermediate_size": 48, "num_hidden_layers": 2,
        "num_attention_heads": 2, "max_position_embeddings": longest, "eos_token_id": ids[1][1],
        "bos_token_id": ids[0][1], "pad_token_id": tokenizer.pad_token_id, "initializer_range": 0.2,
    }  # fmt: skip
    return tokenizer, text


def _owlv2() -> tuple[Any, Any, Any]:
    tokenizer, text = _clip_tokenizer(48)
    vision = {**_SIGLIP, "image_size": 96, "patch_size": 16}
    config = transformers.Owlv2Config(text_config=text, vision_config=vision, projection_dim=32)
    processor = transformers.Owlv2ImageProcessorPil(size={"height": 96, "width": 96})
    return transformers.Owlv2ForObjectDetection(config), tokenizer, processor


def _grounding_dino() -> tuple[Any, Any, Any]:
    tokenizer = tokenizer_with(["[PAD]", "[CLS]", "[SEP]"])
    text = transformers.BertConfig(
        vocab_size=len(tokenizer), hidden_size=32, num_hidden_layers=1, num_attention_heads=2, intermediate_size=48,
        max_position_embeddings=256,
    )  # fmt: skip
    backbone = transformers.SwinConfig(
        image_size=64, embed_dim=16, depths=[1, 1, 1, 1], num_heads=[2, 2, 2, 2], window_size=4,
        out_features=["stage2", "stage3", "stage4"],
    )  # fmt: skip
    config = transformers.GroundingDinoConfig(
        backbone_config=backbone, text_config=text, d_model=32, encoder_layers=1, decoder_layers=2,
        encoder_attention_heads=2, decoder_attention_heads=2, encoder_ffn_dim=48, decoder_ffn_dim=48, num_queries=12,
        disable_custom_kernels=True,
    )  # fmt: skip
    processor = transformers.GroundingDinoImageProcessorPil(size={"shortest_edge": 96, "longest_edge": 192})
    return transformers.GroundingDinoForObjectDetection(config), tokenizer, processor


def _yolos() -> tuple[Any, Any, Any]:
    """A detector with classes; its tokenizer is of no use."""
    names = {0: "chair", 1: "cat", 2: "tv"}
    config = transformers.YolosConfig(
        hidden_size=32, num_hidden_layers=2, num_attention_heads=2, intermediate_size=48, image_size=[64, 64],
        patch_size=16, num_detection_tokens=10, id2label=names, label2id={name: at for at, name in names.items()},
    )  # fmt: skip
    processor = transformers.YolosImageProcessorPil(size={"shortest_edge": 64, "longest_edge": 96})
    return transformers.YolosForObjectDetection(config), tokenizer_with(["<pad>"]), processor


MAKERS: dict[str, Callable[[], tuple[Any, Any, Any]]] = {
    "qwen2_5_vl": _qwen2_5_vl,
    "qwen3_vl": _qwen3_vl,
    "gemma3": _gemma3,
    "llava": _llava,
    "janus": _janus,
    "internvl": _internvl,
    "owlv2": _owlv2,
    "grounding_dino": _grounding_dino,
    "yolos": _yolos,
}


def make(family: str, folder: Path, seed: int = 0) -> Path:
    """A small random model of `family` in `folder`, which is returned."""
    torch.manual_seed(seed)
    model, tokenizer, processor = MAKERS[family]()
    model.save_pretrained(folder)
    tokenizer.save_pretrained(folder)
    processor.save_pretrained(folder)
    return folder


# --- planted weights: one attention head that looks at red things ----------------------------------------------------

HEAD = (LAYERS - 1, 1)  # (layer, head) that is planted; full attention in all families


def marked(azimuth: float, elevation: float, radius: float = 0.3, rows: int = 128, seed: int = 0) -> np.ndarray:
    """A blue panorama ``(rows, 2 rows, 3)`` uint8 with a little noise and a red disc in one direction (radians)."""
    grid = ErpGrid(rows, 2 * rows)
    image = np.array([30, 60, 200]) + np.random.default_rng(seed).integers(-12, 13, size=(rows, 2 * rows, 3))
    image[angular_distance(grid.directions, direction(azimuth, elevation)) < radius] = (255, 0, 0)
    return image.astype(np.uint8)


def redness(image: np.ndarray, planned: InputPlan) -> np.ndarray:
    """How much of each token's window is red in an image, in [0, 1]; NaN for tokens that see padding."""
    red = (image[..., 0] > 128) & (image[..., 2] < 100)
    found = []
    for block in planned.blocks:
        left, top, right, bottom = block.window
        y = (top + (bottom - top) * (np.arange(4 * block.rows) + 0.5) / (4 * block.rows)) * image.shape[0]
        x = (left + (right - left) * (np.arange(4 * block.cols) + 0.5) / (4 * block.cols)) * image.shape[1]
        inside = ((y >= 0) & (y < len(red)))[:, None] & ((x >= 0) & (x < red.shape[1]))
        rows, cols = np.clip(y, 0, len(red) - 1).astype(int), np.clip(x, 0, red.shape[1] - 1).astype(int)
        values = np.where(inside, red[rows[:, None], cols], np.nan)
        found.append(values.reshape(block.rows, 4, block.cols, 4).mean(axis=(1, 3)).ravel())
    return np.concatenate(found)


@torch.no_grad()
def plant(language: LanguageModel, sharpness: float = 10.0) -> None:
    """Change the weights of a tiny model so that head `HEAD` of the last token attends to red image tokens.

    All layers pass their input on unchanged, so that the planted layer sees the image features and the last token as
    they were embedded. Its keys hold how red a token is (a linear reading of the features, fitted here), its query
    asks for that. The other heads attend evenly.
    """
    layers = language.model.model.language_model.layers
    for layer in layers:
        layer.self_attn.o_proj.weight.zero_()
        layer.mlp.down_proj.weight.zero_()
    images, wanted, planned = [], [], language.plan(2.0)
    for seed in range(16):
        rng = np.random.default_rng(100 + seed)
        image = resized(
            marked(rng.uniform(-3, 3), rng.uniform(-0.9, 0.9), rng.uniform(0.2, 0.6), seed=seed), planned.size
        )
        images.append(image)
        wanted.append(redness(image, planned))
    seen: list[torch.Tensor] = []
    hook = layers[HEAD[0]].input_layernorm.register_forward_hook(lambda _module, _inputs, out: seen.append(out))
    prefix = language.share(images, planned, language._cost())
    prefix.branch().feed(language.prompt("red", planned).suffix)
    hook.remove()
    features, last = seen[0][:, prefix.columns].reshape(-1, seen[0].shape[-1]).double(), seen[1][0, -1].double()
    red = np.concatenate(wanted)
    features, red = features[~np.isnan(red)], red[~np.isnan(red)]
    goals = torch.tensor(np.stack([red, np.ones(len(red))], axis=1))
    ridge = 1e-3 * len(features) * torch.eye(features.shape[1], dtype=torch.float64)
    reading = torch.linalg.solve(features.T @ features + ridge, features.T @ goals).T.float()  # (2, hidden)
    attention = layers[HEAD[0]].self_attn
    width = attention.head_dim
    slow, other = width // 2 - 1, width // 2 - 2  # of the dimensions that turn least with the position
    for part in (attention.q_proj, attention.k_proj):
        part.weight.zero_()
        if part.bias is not None:
            part.bias.zero_()
    group = HEAD[1] // (attention.q_proj.out_features // attention.k_proj.out_features)
    attention.k_proj.weight[group * width + slow] = reading[0]
    attention.k_proj.weight[group * width + other] = reading[
        1
    ]  # a constant, for families that scale keys to one length
    strength = sharpness / attention.scaling
    if hasattr(attention, "q_norm"):  # there the norm sets the length of the query
        weight = sharpness / (attention.scaling * width)
        attention.q_norm.weight.fill_(weight - 1 if language.family.name == "gemma3" else weight)
    attention.q_proj.weight[HEAD[1] * width + slow] = (strength * last / last.dot(last)).float()


def language_model(folder: Path, **options: Any) -> LanguageModel:
    """The model in a folder, as the perception has it inside."""
    return load_model(str(folder), **options)
