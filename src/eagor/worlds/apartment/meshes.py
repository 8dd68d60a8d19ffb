"""All primitives under one roof: see `mesh` for the conventions, `solids` and `curved` for the shapes."""

from eagor.worlds.apartment.curved import cushion, cylinder, lathe, pillow, quad, sheet, slab, tube
from eagor.worlds.apartment.mesh import (
    Mesh,
    Part,
    merged,
    mirrored,
    moved,
    part,
    planar_uv,
    reshaped,
    turned,
)  # fmt: skip
from eagor.worlds.apartment.solids import (
    bevelled,
    board,
    box,
    hexahedron,
    loft,
    post,
    prism,
    rounded_rectangle,
)  # fmt: skip

__all__ = [
    "Mesh",
    "Part",
    "bevelled",
    "board",
    "box",
    "cushion",
    "cylinder",
    "hexahedron",
    "lathe",
    "loft",
    "merged",
    "mirrored",
    "moved",
    "part",
    "pillow",
    "planar_uv",
    "post",
    "prism",
    "quad",
    "reshaped",
    "rounded_rectangle",
    "sheet",
    "slab",
    "tube",
    "turned",
]
