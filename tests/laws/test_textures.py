"""Materials and their textures: seamless, repeatable, and of the colour that was asked for."""

import numpy as np
import pytest
from hypothesis import strategies as st

from eagor._srgb import to_coded, to_linear
from eagor.lab.worlds.apartment import textures
from eagor.lab.worlds.apartment.textures import KINDS, material
from eagor.perception.colour import ColourPerception
from eagor.queries import COLOURS

WHOLE = ("leaf", "lampshade")  # each drawing is one thing from edge to edge
REPEATING = [
    (kind, variant)
    for kind, look in KINDS.items()
    for variant in range(look.variants)
    if look.draw and not look.picture and kind not in WHOLE
]
COLOURED = ["fabric", "leather", "paint", "plastic", "ceramic", "carpet", "wood"]
SEEDS = st.integers(0, 2**32 - 1)
perceive = ColourPerception(rows=48)


def worst_step(image, axis):
    """Largest mean difference between neighbouring lines, and that across the seam."""
    steps = np.abs(np.diff(image.astype(float), axis=axis)).mean(axis=(1 - axis, 2))
    ends = np.take(image, [0, -1], axis=axis).astype(float)
    return steps.max(), np.abs(np.diff(ends, axis=axis)).mean()


@pytest.mark.parametrize(("kind", "variant"), REPEATING)
def test_textures_repeat_without_a_seam(kind, variant):
    image, _ = textures._texture(kind, None, variant)
    for axis in (0, 1):
        inside, seam = worst_step(image, axis)
        assert seam <= 1.25 * inside + 0.5


def wall_of(look):
    """The material as a flat lit patch: uint8."""
    image = np.ones((32, 64, 3)) if look.texture is None else to_linear(look.texture / 255)
    return np.rint(255 * to_coded(image * to_linear(np.array(look.colour)))).astype(np.uint8)


@pytest.mark.parametrize("kind", COLOURED)
@pytest.mark.parametrize("colour", COLOURS)
def test_materials_are_seen_as_their_colour(kind, colour):
    image = wall_of(material(kind, colour, np.random.default_rng(0)))
    seen = {name: float(perceive.respond(image, name).mean()) for name in COLOURS}
    assert max(seen, key=lambda name: seen[name]) == colour
    assert seen[colour] > 0.5
