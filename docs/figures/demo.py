"""The picture of the tutorial: four moments of the search that ``eagor demo`` shows.

python docs/figures/demo.py [OUT.jpg]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image

from eagor.cli import main as eagor

IMAGES = Path(__file__).parents[1] / "images"
QUALITY = 82


def main() -> None:
    """Search, and keep the picture of the beliefs as a JPEG."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES / "demo.jpg"
    with tempfile.TemporaryDirectory() as folder:
        if code := eagor(["demo", "--out", folder]):
            sys.exit(code)
        with Image.open(Path(folder) / "beliefs.png") as picture:
            picture.convert("RGB").save(out, quality=QUALITY, optimize=True)


if __name__ == "__main__":
    main()
