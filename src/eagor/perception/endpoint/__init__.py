"""A vision-language model on a server: vLLM, SGLang, Ollama, llama.cpp, ``transformers serve``, or a hosted one.

Anything that speaks OpenAI's chat completions will do. Such a server gives words and, at best, their probabilities, so
there are two ways to ask (the attention of a model needs the model itself: `eagor.perception.transformers`):

- ``boxes``: the boxes of the thing in the whole panorama, and once more in the panorama rolled by half a turn, so that
  the seam cuts nothing. Two requests for each query. For models that were trained to write boxes.
- ``views``: overlapping tangent views, one request each for each query, that ask whether the thing is there (or for
  boxes). For models that know only ordinary photographs.

Pictures are resized here, to whole cells of the model, so that no server resizes them.
"""

from eagor.perception.endpoint.naming import from_text
from eagor.perception.endpoint.perception import EndpointPerception, Look

__all__ = ["EndpointPerception", "Look", "from_text"]
