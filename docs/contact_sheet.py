"""Draw one panorama of each of twenty apartments on one sheet: ``python docs/contact_sheet.py OUT.jpg [FIRST]``."""

from __future__ import annotations

import sys

import numpy as np
from PIL import Image, ImageDraw

from eagor.lab.worlds.apartment import generate
from eagor.lab.worlds.ground import Ground
from eagor.lab.worlds.render import Renderer
from eagor.sphere import world_R_body

COLUMNS, COUNT, ROWS, HEIGHT = 4, 20, 160, 1.4


def panorama(seed: int) -> tuple[np.ndarray, str]:
    """The apartment from the roomiest point of its largest room, and what it is."""
    scene = generate(seed)
    ground = Ground.from_scene(scene)
    room = max(scene.rooms, key=lambda room: room.area)
    cells = np.argwhere(ground.free)
    points = ground.centres(cells)
    inside = np.array([room.contains(x, y) for x, y in points])
    best = np.argmax(np.where(inside, ground.clearance[cells[:, 0], cells[:, 1]], -1.0))
    frame = Renderer(scene).panorama(np.array([*points[best], HEIGHT]), world_R_body(0.4), ROWS, range=False, ids=False)
    assert frame.rgb is not None
    return frame.rgb, f"{seed}: {scene.facts['family']}"


def main(out: str, first: int = 0) -> None:
    """Draw the sheet."""
    sheet = Image.new("RGB", (COLUMNS * 2 * ROWS, (COUNT // COLUMNS) * (ROWS + 18)), "white")
    pen = ImageDraw.Draw(sheet)
    for index in range(COUNT):
        picture, what = panorama(first + index)
        x, y = index % COLUMNS * 2 * ROWS, index // COLUMNS * (ROWS + 18)
        sheet.paste(Image.fromarray(picture), (x, y + 18))
        pen.text((x + 4, y + 3), what, fill="#1f2430")
        print(f"   {what}", flush=True)
    sheet.save(out, quality=85)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 0)
