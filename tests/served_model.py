"""A tiny Gemma-3 that says the same about every picture, served by ``transformers serve`` in a process of its own."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

TEMPLATE = (
    "{{ bos_token }}{% for message in messages %}{{ '<start_of_turn>user\n' }}"
    "{% for part in message['content'] %}{% if part['type'] == 'image' %}{{ '<start_of_image>' }}"
    "{% else %}{{ part['text'] }}{% endif %}{% endfor %}{{ '<end_of_turn>\n' }}{% endfor %}"
    "{% if add_generation_prompt %}{{ '<start_of_turn>model\n' }}{% endif %}"
)
IMAGE_TOKENS = 64


def write_model(folder: Path, says: str) -> None:
    """A model, its processor and its tokenizer in `folder`; its only answer is `says`."""
    import torch
    import transformers
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers

    letters = sorted(pre_tokenizers.ByteLevel.alphabet())
    raw = Tokenizer(models.BPE(vocab={letter: index for index, letter in enumerate(letters)}, merges=[]))
    raw.pre_tokenizer, raw.decoder = pre_tokenizers.ByteLevel(add_prefix_space=False), decoders.ByteLevel()
    images = {"boi_token": "<start_of_image>", "eoi_token": "<end_of_image>", "image_token": "<image_soft_token>"}
    names = {"bos_token": "<bos>", "eos_token": "<eos>", "pad_token": "<pad>"}
    tokenizer = transformers.PreTrainedTokenizerFast(
        tokenizer_object=raw, **names, extra_special_tokens=images, chat_template=TEMPLATE
    )
    tokenizer.add_tokens(["<start_of_turn>", "<end_of_turn>"], special_tokens=True)
    tokenizer.add_tokens([says])
    ids = {name: tokenizer.convert_tokens_to_ids(token) for name, token in {**images, **names}.items()}
    text: dict[str, Any] = {
        "vocab_size": len(tokenizer), "hidden_size": 64, "intermediate_size": 32, "num_hidden_layers": 2,
        "num_attention_heads": 2, "num_key_value_heads": 1, "head_dim": 16, "max_position_embeddings": 4096,
        "pad_token_id": ids["pad_token"], "eos_token_id": ids["eos_token"], "bos_token_id": ids["bos_token"],
    }  # fmt: skip
    vision = {
        "hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2,
        "image_size": 224, "patch_size": 14,
    }  # fmt: skip
    config = transformers.Gemma3Config(
        text_config=text,
        vision_config=vision,
        mm_tokens_per_image=IMAGE_TOKENS,
        boi_token_index=ids["boi_token"],
        eoi_token_index=ids["eoi_token"],
        image_token_index=ids["image_token"],
        tie_word_embeddings=False,
    )
    torch.manual_seed(0)
    model = transformers.Gemma3ForConditionalGeneration(config)
    with torch.no_grad():  # what comes next depends on the last token alone
        language = model.model.language_model
        for layer in language.layers:
            layer.self_attn.o_proj.weight.zero_()
            layer.mlp.down_proj.weight.zero_()
        embeddings = torch.nn.init.orthogonal_(torch.empty(len(tokenizer), 64)) * 8
        language.embed_tokens.weight.copy_(embeddings)
        model.lm_head.weight.zero_()
        (newline,) = tokenizer.encode("\n", add_special_tokens=False)
        said = tokenizer.convert_tokens_to_ids(says)
        model.lm_head.weight[said] = embeddings[newline]
        model.lm_head.weight[ids["eos_token"]] = embeddings[said]
    model.generation_config.eos_token_id = ids["eos_token"]
    model.save_pretrained(folder)
    processor = transformers.Gemma3ImageProcessorPil(size={"height": 224, "width": 224})
    transformers.Gemma3Processor(processor, tokenizer, TEMPLATE, image_seq_length=IMAGE_TOKENS).save_pretrained(folder)


@contextmanager
def served(folder: Path, seconds: float = 600.0) -> Iterator[str]:
    """The address of ``transformers serve`` with the model in `folder`, on a free port of this machine."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-c", "from transformers.cli.transformers import main; main()", "serve", str(folder)]
    command += ["--device", "cpu", "--host", "127.0.0.1", "--port", str(port)]
    (folder / "hub").mkdir(exist_ok=True)  # what it lists, besides the model that it was given
    quiet = {
        "HF_HUB_OFFLINE": "1",
        "HF_HUB_CACHE": str(folder / "hub"),
        "OMP_NUM_THREADS": "1",
        "TOKENIZERS_PARALLELISM": "false",
    }
    log = (folder / "server.log").open("wb")
    process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env={**os.environ, **quiet})
    try:
        end = time.monotonic() + seconds
        while True:
            try:
                with urlopen(f"http://127.0.0.1:{port}/v1/models", timeout=5):
                    break
            except (URLError, OSError):
                text = (folder / "server.log").read_text(errors="replace")
                assert process.poll() is None, f"the server ended: {text[-2000:]}"
                assert time.monotonic() < end, f"the server did not start: {text[-2000:]}"
                time.sleep(0.1)
        yield f"http://127.0.0.1:{port}/v1"
    finally:
        process.terminate()
        process.wait(30)
        log.close()
