"""Furniture of every category, in every colour, from any seed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eagor.lab.worlds.apartment.furniture import KINDS, build
from eagor.lab.worlds.apartment.mesh import merged
from eagor.lab.worlds.scene import Raycaster
from eagor.queries import COLOURS, parse_query

BUDGET = 1800  # triangles of one piece
PIECES = [(category, colour) for category, kind in sorted(KINDS.items()) for colour in kind.colours or (None,)]
SEEDS = st.integers(0, 2**32 - 1)


def joined(model):
    """Vertices, triangles and the part of each triangle."""
    whole = merged(*model.parts)
    owner = np.repeat(np.arange(len(model.parts)), [len(piece.triangles) for piece in model.parts])
    return whole.vertices, whole.triangles, owner


def model_box(model, placement):
    """Where the parts have to lie."""
    x, y, z = model.size
    low, high = np.array([-x / 2, -y / 2, 0]), np.array([x / 2, y / 2, z])
    if placement == "hung":
        low, high = np.array([0, -y / 2, -z / 2]), np.array([x, y / 2, z / 2])
    if placement == "ceiling":
        low, high = low - [0, 0, z], high - [0, 0, z]
    return low, high


@pytest.mark.parametrize(("category", "colour"), PIECES)
@given(seed=SEEDS)
@settings(max_examples=2)
def test_every_piece_is_sound(category, colour, seed):
    model = build(category, colour, seed)
    assert (model.category, model.colour) == (category, colour)
    query = parse_query(f"the {colour or ''} {category}", KINDS)
    assert (query.category, query.colour) == (category, colour), "it can be asked for by its name"
    vertices, triangles, _ = joined(model)
    for piece in model.parts:
        assert (piece.vertices.dtype, piece.triangles.dtype, piece.uv.dtype) == (np.float32, np.int32, np.float32)
        assert piece.uv.shape == (len(piece.triangles), 3, 2)
        assert np.isfinite(piece.uv).all()
        assert piece.triangles.min() >= 0
        assert piece.triangles.max() < len(piece.vertices)
        assert (np.array(piece.material.colour) >= 0).all()
        assert (np.array(piece.material.colour) <= 1).all()
    assert np.isfinite(vertices).all()
    low, high = model_box(model, KINDS[category].placement)
    assert np.allclose(vertices.min(axis=0), low, atol=1e-4)
    assert np.allclose(vertices.max(axis=0), high, atol=1e-4)
    a, b, c = vertices[triangles].transpose(1, 0, 2).astype(float)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 1e-10
    assert 2 <= len(triangles) <= BUDGET
    for lamp in model.lamps:
        assert (lamp.position >= low - 0.3).all()
        assert (lamp.position <= high + 0.3).all()
        assert (np.asarray(lamp.power) >= 0).all()


def seen(model, azimuth, elevation=0.3, across=40):
    """What parallel rays from a direction meet: part, and whether its outside, ``(n,)`` both."""
    vertices, triangles, owner = joined(model)
    c, s = np.cos(azimuth), np.sin(azimuth)
    towards = -np.array([np.cos(elevation) * c, np.cos(elevation) * s, np.sin(elevation)])
    right, middle = np.array([-s, c, 0]), (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    up, radius = np.cross(right, towards) * -1, np.linalg.norm(np.ptp(vertices, axis=0)) / 2
    step = (np.arange(across) + 0.5) / across * 2 - 1
    offsets = step[:, None, None] * up + step[None, :, None] * right
    origins = (middle - 3 * radius * towards + radius * offsets).reshape(-1, 3)
    hits = Raycaster(vertices, triangles).cast(origins, np.broadcast_to(towards, origins.shape).astype(np.float32))
    hit = hits.triangle[hits.triangle >= 0]
    a, b, c = vertices[triangles[hit]].transpose(1, 0, 2)
    return owner[hit], np.cross(b - a, c - a) @ towards < 0


@pytest.mark.parametrize(("category", "colour"), [piece for piece in PIECES if piece[1]])
def test_the_colour_that_is_asked_for_is_what_is_seen(category, colour):
    elevation = -0.3 if KINDS[category].placement == "ceiling" else 0.3  # from where a person looks at it
    for seed in range(2):
        model = build(category, colour, seed)
        parts = np.concatenate([seen(model, turn, elevation)[0] for turn in (0.5, -0.5)])
        names = [model.parts[place].material.name for place in parts]
        shares = {name: names.count(name) / len(names) for name in set(names)}
        words = {name.split()[0] for name in shares} & set(COLOURS)  # books and bare metal have no colour of their own
        total = {word: sum(share for name, share in shares.items() if name.split()[0] == word) for word in words}
        assert max(total, key=lambda word: total[word]) == colour, shares
        assert total[colour] > 0.4, shares
