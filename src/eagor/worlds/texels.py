"""All textures of a scene in one flat array of texels, each in a pyramid of halved sizes, tinted beforehand.

A texel is one number: red + green 2^8 + blue 2^16, sRGB-coded reflectance. Pyramids are square with sides that are
powers of two, so that a place in them is found by shifts and masks alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eagor._srgb import to_coded, to_linear
from eagor.worlds.scene import Material

LEVELS = 12  # sides up to 2048 texels, halved down to 1
_LARGEST = 1 << (LEVELS - 1)


@dataclass(frozen=True, eq=False)
class Texels:
    """The pyramids of a scene's materials.

    `texels` ``(n,)`` int32; for material m at level l (0: full size), at place m * LEVELS + l, `base`
    ``(M * LEVELS,)`` int32 is where its rows begin, and `log_side` the logarithm of its side to base 2; levels beyond
    the last repeat it.
    """

    texels: np.ndarray
    base: np.ndarray
    log_side: np.ndarray

    @classmethod
    def of(cls, materials: tuple[Material, ...]) -> Texels:
        """The pyramids of `materials`."""
        pyramids: dict[int, list[np.ndarray]] = {}
        texels, base, log_side, start = [], [], [], 0
        for material in materials:
            key = 0 if material.texture is None else id(material.texture)
            if key not in pyramids:
                pyramids[key] = _pyramid(material.texture)
            tint = to_linear(np.clip(np.asarray(material.colour, dtype=np.float64), 0, 1))
            levels = [_tinted(level, tint) for level in pyramids[key]]
            for k in range(LEVELS):
                level = levels[min(k, len(levels) - 1)]
                base.append(start + sum(len(other) for other in levels[: min(k, len(levels) - 1)]))
                log_side.append(len(level).bit_length() // 2)
            texels.extend(levels)
            start += sum(len(level) for level in levels)
        return cls(np.concatenate(texels), np.array(base, dtype=np.int32), np.array(log_side, dtype=np.int32))


def _pyramid(texture: np.ndarray | None) -> list[np.ndarray]:
    """The levels of a texture, ``(side^2, 3)`` uint8 each, row 0 at the bottom (v points up)."""
    if texture is None:
        return [np.full((1, 3), 255, dtype=np.uint8)]
    texture = texture[::-1, :, :3]
    side = 1 << min(int(np.ceil(np.log2(max(texture.shape[:2])))), LEVELS - 1)
    if texture.shape[:2] != (side, side):
        from PIL import Image

        texture = np.asarray(Image.fromarray(np.ascontiguousarray(texture)).resize((side, side)))
    levels = [texture.reshape(-1, 3)]
    decode = to_linear(np.arange(256) / 255).astype(np.float32)
    encode = np.rint(255 * to_coded(np.arange(4096) / 4095)).astype(np.uint8)
    level = decode[texture]
    while len(level) > 1:
        level = (level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2]) / 4
        levels.append(encode[np.rint(level * 4095).astype(np.int32)].reshape(-1, 3))
    return levels


def _tinted(level: np.ndarray, tint: np.ndarray) -> np.ndarray:
    """Packed texels of a level, times a linear colour."""
    table = np.rint(255 * to_coded(to_linear(np.arange(256) / 255)[:, None] * tint)).astype(np.int32)
    r, g, b = (table[level[:, k], k] for k in range(3))
    return r | g << 8 | b << 16
