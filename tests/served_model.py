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
    import vlm_models

    torch.manual_seed(0)
    model, tokenizer, processor = vlm_models.MAKERS["gemma3"]()
    tokenizer.add_tokens([says])
    tokenizer.chat_template = TEMPLATE
    model.resize_token_embeddings(len(tokenizer))
    language = model.model.language_model
    with torch.no_grad():  # what comes next depends on the last token alone
        for layer in language.layers:
            layer.self_attn.o_proj.weight.zero_()
            layer.mlp.down_proj.weight.zero_()
        embeddings = torch.nn.functional.normalize(torch.randn(len(tokenizer), vlm_models.TEXT["hidden_size"]), dim=-1)
        language.embed_tokens.weight.copy_(8 * embeddings)
        model.config.tie_word_embeddings = False
        model.lm_head.weight = torch.nn.Parameter(torch.zeros_like(embeddings))
        (newline,) = tokenizer.encode("\n", add_special_tokens=False)
        said = tokenizer.convert_tokens_to_ids(says)
        model.lm_head.weight[said] = embeddings[newline]
        model.lm_head.weight[tokenizer.eos_token_id] = embeddings[said]
    model.generation_config.eos_token_id = tokenizer.eos_token_id
    model.save_pretrained(folder)
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
