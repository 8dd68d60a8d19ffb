"""Named colours as furniture wears them: cloth, paint and wood rather than pure primaries.

The names are those of `eagor.queries.COLOURS`. Each has a few tones, and every call shifts the tone a little, so that
two red chairs are both red and still not alike.
"""

from __future__ import annotations

import numpy as np

from eagor.errors import WorldError
from eagor.queries import COLOURS

RGB = tuple[float, float, float]

# sRGB, 0 to 255. Chosen to keep their name from full light down to a third of it, as far as the name allows: beige
# and pink in deep shade are brown and purple to anyone, white is grey.
TONES: dict[str, tuple[tuple[int, int, int], ...]] = {
    "black": ((32, 32, 34), (27, 26, 28), (35, 33, 32)),
    "white": ((243, 241, 236), (238, 238, 236), (245, 244, 241)),
    "grey": ((128, 130, 132), (148, 148, 147), (106, 109, 112), (139, 137, 134)),
    "red": ((168, 38, 42), (182, 48, 44), (150, 32, 38)),
    "orange": ((216, 112, 34), (224, 126, 44), (204, 102, 30)),
    "yellow": ((224, 180, 50), (216, 170, 40), (232, 190, 66)),
    "green": ((66, 112, 72), (88, 124, 70), (48, 98, 70)),
    "blue": ((56, 88, 140), (76, 112, 160), (44, 66, 112)),
    "purple": ((106, 62, 132), (122, 78, 150), (92, 52, 116)),
    "pink": ((224, 146, 164), (216, 132, 154), (232, 162, 176)),
    "brown": ((122, 80, 48), (106, 68, 40), (136, 90, 54)),
    "beige": ((216, 198, 166), (222, 206, 176), (208, 190, 156)),
}


def sRGB(colour: str, rng: np.random.Generator) -> RGB:
    """A believable tone of a named colour, sRGB in [0, 1]. Raises `WorldError` for a name outside `COLOURS`."""
    if colour not in TONES:
        raise WorldError(f"there is no colour {colour!r}; wanted one of {', '.join(COLOURS)}")
    tones = TONES[colour]
    tone = np.array(tones[rng.integers(len(tones))]) / 255
    hue = 0.005 if colour in ("black", "white", "grey") else 0.015  # white that drifts further is pink or green
    shifted = tone * rng.uniform(0.95, 1.05) * rng.uniform(1 - hue, 1 + hue, size=3)
    r, g, b = np.clip(shifted, 0.0, 0.97)
    return float(r), float(g), float(b)
