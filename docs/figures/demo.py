"""The picture of the quick start: four moments of the search that ``eagor demo`` shows.

python docs/figures/demo.py [OUT.jpg]
python docs/figures/demo.py --choose    # play development searches, until one fits the rule for the demo (minutes)

The rule: the first search, from apartment 0 on, in which the thing, once seen, gets hidden again for 5 seconds or more
while our tracker steers. It looks at what is in sight and not at who is right.
"""

from __future__ import annotations

import sys
import tempfile
from itertools import product
from pathlib import Path

from PIL import Image

from eagor.cli import main as eagor
from eagor.cli.demo_apartment import play
from eagor.lab.envs.episodes import PER_PLACE
from eagor.lab.envs.rules import Camera

IMAGES = Path(__file__).parents[1] / "images"
QUALITY = 82
DEVELOPMENT, AGAIN = 2000, 5.0  # seeds from 0 on; seconds


def choose() -> None:
    """Print the searches in order, down to the first that fits the rule."""
    for seed, index in product(range(DEVELOPMENT), range(PER_PLACE)):
        search = play(seed, index, "scout")
        again = search.hidden if search.visible[0] else search.hidden[1:]
        longest = Camera().seconds * max((end - begin + 1 for begin, end in again), default=0)
        print(f"apartment {seed}, search {index}, {search.thing}: hidden again for {longest:g} s", flush=True)
        if longest >= AGAIN:
            break


def main() -> None:
    """Search, and keep the picture of the beliefs as a JPEG."""
    if sys.argv[1:] == ["--choose"]:
        return choose()
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES / "demo.jpg"
    with tempfile.TemporaryDirectory() as folder:
        if code := eagor(["demo", "--out", folder]):
            sys.exit(code)
        with Image.open(Path(folder) / "beliefs.png") as picture:
            picture.convert("RGB").save(out, quality=QUALITY, optimize=True)


if __name__ == "__main__":
    main()
