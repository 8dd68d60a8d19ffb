"""Small random models of the real architectures, saved with tokenizer and image processor as a hub folder would be."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
import transformers
from tokenizers import Tokenizer, decoders, models, pre_tokenizers

LANGUAGE = ("qwen2_5_vl", "qwen3_vl", "gemma3", "llava", "janus", "internvl")
LOCALISERS = ("owlv2", "grounding_dino", "clipseg")
LAYERS = 3

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
    return transformers.PreTrainedTokenizerFast(tokenizer_object=raw, additional_special_tokens=specials, **roles)


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
        vision_config={**vision, "fullatt_block_indexes": [1], "window_size": 56, "initializer_range": 0.2},
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
    edges = {f"vision_{edge}_token_id": tokenizer.convert_tokens_to_ids(f"<|vision_{edge}|>") for edge in ("start", "end")}
    return {**ids, **edges}


def _qwen3_vl() -> tuple[Any, Any, Any]:
    words = ["<|im_end|>", "<|im_start|>", "<|vision_start|>", "<|vision_end|>", "<|image_pad|>", "<|video_pad|>"]
    tokenizer = tokenizer_with(words)
    rope = {"rope_type": "default", "mrope_section": [2, 1, 1], "rope_theta": 5e6}
    vision = {"depth": 2, "hidden_size": 32, "intermediate_size": 48, "num_heads": 2, "out_hidden_size": 32}
    config = transformers.Qwen3VLConfig(
        text_config=_sizes(tokenizer, head_dim=8, rope_parameters=rope),
        vision_config={
            **vision, "deepstack_visual_indexes": [0], "num_position_embeddings": 64, "initializer_range": 0.2
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
    "initializer_range": 0.2,
}  # fmt: skip


def _llava() -> tuple[Any, Any, Any]:
    tokenizer = tokenizer_with(["</s>", "<s>", "<image>"], bos_token="<s>")
    config = transformers.LlavaConfig(
        text_config=transformers.LlamaConfig(**_sizes(tokenizer)),
        vision_config=transformers.CLIPVisionConfig(**_SIGLIP, image_size=112, patch_size=14),
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
        "hidden_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2, "image_size": 112, "patch_size": 14,
        "mlp_ratio": 1.5, "projection_dim": 32, "depth": 1, "num_image_tokens": 64, "initializer_range": 0.2,
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
            patch_size=[7, 7], initializer_range=0.2,
        ),
        image_token_id=tokenizer.convert_tokens_to_ids("<IMG_CONTEXT>"),
        image_seq_length=16,
    )  # fmt: skip
    processor = transformers.GotOcr2ImageProcessorPil(size={"height": 56, "width": 56})
    return transformers.InternVLForConditionalGeneration(config), tokenizer, processor


MAKERS: dict[str, Callable[[], tuple[Any, Any, Any]]] = {
    "qwen2_5_vl": _qwen2_5_vl,
    "qwen3_vl": _qwen3_vl,
    "gemma3": _gemma3,
    "llava": _llava,
    "janus": _janus,
    "internvl": _internvl,
}


def make(family: str, folder: Path, seed: int = 0) -> Path:
    """A small random model of `family` in `folder`, which is returned."""
    torch.manual_seed(seed)
    model, tokenizer, processor = MAKERS[family]()
    model.save_pretrained(folder)
    tokenizer.save_pretrained(folder)
    processor.save_pretrained(folder)
    return folder
