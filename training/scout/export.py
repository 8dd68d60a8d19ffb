"""Export a trained scout: ``scout.onnx`` and ``vocabulary.json``.

    python export.py RUN/last.pt [--to ../../src/eagor/perception/scout]

The graph takes ``image`` ``(1, H, 2H, 3)`` uint8 and ``words`` ``(Q, 2)`` int64 (category, colour; the number of
colours for none). It gives ``response`` ``(Q, h, w)``, the heat times the probability of presence, and ``presence``
``(Q,)``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from evaluate import onnx_respond
from model import COARSEST, STRIDE, Scout
from samples import CLASSES, NO_COLOUR, WORDS
from torch import Tensor, nn

from eagor.queries import COLOURS

MOST_BYTES = 6_000_000


class Exported(nn.Module):
    """From the panorama as it is stored to the response."""

    def __init__(self, model: Scout) -> None:
        super().__init__()
        self.model = model

    def forward(self, image: Tensor, words: Tensor) -> tuple[Tensor, Tensor]:
        picture = image.permute(0, 3, 1, 2).float() / 255
        heat, presence = self.model(picture, words.unsqueeze(0))
        likely = torch.sigmoid(presence)
        return (torch.sigmoid(heat) * likely.unsqueeze(-1).unsqueeze(-1)).squeeze(0), likely.squeeze(0)


def export(weights: Path, folder: Path) -> Path:
    """Write both files into `folder`; raises `AssertionError` if the graph answers unlike the model."""
    model = Scout(len(WORDS), NO_COLOUR, len(CLASSES))
    model.load_state_dict(torch.load(weights, weights_only=True))
    exported = Exported(model).eval()
    rows = model.size.rows
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, size=(rows, 2 * rows, 3), dtype=np.uint8)
    words = np.stack([rng.integers(len(WORDS), size=5), rng.integers(NO_COLOUR + 1, size=5)], axis=1)
    given = (torch.from_numpy(image)[None], torch.from_numpy(words))
    file = folder / "scout.onnx"
    with torch.inference_mode():
        torch.onnx.export(
            exported,
            given,
            file,
            input_names=["image", "words"],
            output_names=["response", "presence"],
            dynamic_axes={"words": {0: "queries"}, "response": {0: "queries"}, "presence": {0: "queries"}},
            opset_version=17,
            dynamo=False,
        )
        wanted = exported(*given)[0].numpy()
    found = onnx_respond(file)(image, words)
    assert np.abs(found - wanted).max() < 1e-5, f"differs by {np.abs(found - wanted).max():.2g}"
    assert file.stat().st_size <= MOST_BYTES, f"{file.stat().st_size} bytes; wanted at most {MOST_BYTES}"
    vocabulary = {"categories": list(WORDS), "colours": list(COLOURS), "rows": rows, "stride": STRIDE, "roll": COARSEST}
    text = json.dumps(vocabulary, indent=1) + "\n"
    (folder / "vocabulary.json").write_text(text, encoding="utf-8")
    return file


def main() -> None:
    """The command line."""
    default = Path(__file__).parents[2] / "src/eagor/perception/scout"
    parser = argparse.ArgumentParser(description="Export a trained scout.")
    parser.add_argument("weights", type=Path)
    parser.add_argument("--to", type=Path, default=default)
    given = parser.parse_args()
    file = export(given.weights, given.to)
    print(f"{file}: {file.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
