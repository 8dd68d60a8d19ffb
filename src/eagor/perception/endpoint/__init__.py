"""A vision-language model on a server: vLLM, SGLang, Ollama, llama.cpp, ``transformers serve``, or a hosted one.

Anything that speaks OpenAI's chat completions will do. A server gives words and, at best, their probabilities: it is
asked for ``boxes`` in the whole panorama and once more in the panorama rolled by half a turn, or shown ``views`` that
cover the sphere (docs/models.md). Attention needs the model itself: `eagor.perception.transformers`.
"""

from eagor.perception.endpoint.perception import EndpointPerception, Look, from_text

__all__ = ["EndpointPerception", "Look", "from_text"]
