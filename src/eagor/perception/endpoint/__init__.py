"""A vision-language model on a server: vLLM, SGLang, Ollama, llama.cpp, ``transformers serve``, or a hosted one.

It works with any server that speaks OpenAI's chat completions. A server returns text and, at best, token probabilities.
It is asked for ``boxes`` in the whole panorama and again in the panorama rolled by half a turn, or shown ``views`` that
cover the sphere (docs/models.md). Attention needs a local model: `eagor.perception.transformers`.
"""

from eagor.perception.endpoint.perception import EndpointPerception, Look, from_text

__all__ = ["EndpointPerception", "Look", "from_text"]
