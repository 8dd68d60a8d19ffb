"""What files look like after a careless hand, a cut-off writer or a bad disk: mutations of valid texts and bytes.

The property that all readers of this package are held against is `reads`.
"""

import copy
import json
import math
import struct
import warnings
import zlib

from hypothesis import strategies as st

from eagor.errors import EagorError

# Values that a careless writer puts where another was wanted. The tagged texts become what json.dumps cannot write.
ODD = [
    None, True, False, 0, 1, -1, 0.5, 2.5, -0.0, 1e-300, 1e6, 1e12, 1e300, -1e300, 10**30, -(10**400), math.nan,
    math.inf, -math.inf, "", " ", "0", "12", "nan", "x", "../x", "a\0b", "\ud800", "\u2028", "\u03b1",
    [], {}, [[]], [None], ["1", "2"], [1], [1, 2], [2, 1], [1, 2, 3], [1, 2, 3, 4], [[1, 2], [3, 4]], {"a": 1},
    "\x01digits",
    "\x01large", "\x01deep", "\x01deeper", "\x01long",
]  # fmt: skip
TAGGED = {
    '"\\u0001digits"': "1" * 5000,  # more digits than Python turns into a number
    '"\\u0001large"': "1e999",
    '"\\u0001deep"': "[" * 700 + "]" * 700,
    '"\\u0001deeper"': "[" * 3000 + "]" * 3000,
    '"\\u0001long"': '"' + "long " * 400 + '"',
}
BITS = [b"", b"\0", b"\xff", b"\xfe\xff", b"\xef\xbb\xbf", b"\n", b"\r", b"\r\n", b",", b'"', b"'", b"{", b"}",
        b"[", b"]", b"nan", b"1e999", b"-", b"#", b"\xc3", "\u2028".encode(), b"\x1a", b" " * 50,
        b"9" * 5000, b"[" * 3000]  # fmt: skip


def places(tree, path=()):
    """The paths of all values in a tree of dicts and lists, the root's () first."""
    yield path
    inner = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in inner:
        yield from places(value, (*path, key))


def put(tree, path, value):
    """`tree` with `value` at a path (in place, but for the root)."""
    if not path:
        return value
    at = tree
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return tree


def taken_out(tree, path):
    """`tree` without what is at a path (in place)."""
    if path:
        at = tree
        for key in path[:-1]:
            at = at[key]
        del at[path[-1]]
    return tree


def as_text(tree):
    """A tree as JSON, with what JSON should not hold (NaN, numbers of 5000 digits, lists 3000 deep)."""
    text = json.dumps(tree)
    for tag, meant in TAGGED.items():
        text = text.replace(tag, meant)
    return text


@st.composite
def trees(draw, valid, most=3):
    """A tree of JSON like one of the valid ones, with up to `most` odd values, missing keys, or copies."""
    tree = copy.deepcopy(draw(st.sampled_from(valid)))
    for _ in range(draw(st.integers(1, most))):
        path = draw(st.sampled_from(list(places(tree))))
        how = draw(st.sampled_from(["odd", "odd", "odd", "out", "swap", "again"]))
        if how == "odd":
            tree = put(tree, path, copy.deepcopy(draw(st.sampled_from(ODD))))
        elif how == "out":
            tree = taken_out(tree, path)
        elif how == "again" and path and isinstance(path[-1], int):
            at = tree
            for key in path[:-1]:
                at = at[key]
            at.append(copy.deepcopy(at[path[-1]]))
        elif how == "swap":
            other = draw(st.sampled_from(list(places(tree))))
            at = tree
            for key in other:
                at = at[key]
            tree = put(tree, path, copy.deepcopy(at))
    return tree


@st.composite
def damaged(draw, valid, most=3):
    """Bytes like some of the valid ones: cut, with bits put in, taken out, doubled or overwritten; or any bytes."""
    if draw(st.integers(0, 9)) == 0:
        return draw(st.binary(max_size=200))
    data = draw(st.sampled_from(valid))
    for _ in range(draw(st.integers(1, most))):
        start = draw(st.integers(0, len(data)))
        end = min(len(data), start + draw(st.integers(0, 12)))
        how = draw(st.sampled_from(["cut", "put in", "take out", "double", "overwrite"]))
        if how == "cut":
            data = data[:start]
        elif how == "put in":
            data = data[:start] + draw(st.sampled_from(BITS)) + data[start:]
        elif how == "take out":
            data = data[:start] + data[end:]
        elif how == "double":
            data = data[:end] + data[start:end] + data[end:]
        else:
            data = data[:start] + draw(st.binary(min_size=end - start, max_size=end - start)) + data[end:]
    return data


def reads(reader, *names, also=()):
    """What `reader` gives; None where it raised an `EagorError` that names each of `names` and one of `also`.

    Anything else that it raises fails the test. Warnings are its own affair.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return reader()
    except EagorError as error:
        said = str(error)
        assert all(name in said for name in names), f"{said!r} does not name {names}"
        assert not also or any(word in said for word in also), f"{said!r} names none of {also}"
        assert len(said) < 2000, f"an error of {len(said)} characters"
        return None


NOTHING = zlib.compress(b"")


def png(width, height, depth=8, colour=2, packed=NOTHING):
    """A PNG that claims a size."""

    def chunk(name, body):
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


def glb(tree, binary=b""):
    """A GLB file with this JSON and this binary."""
    text = as_text(tree).encode("utf-8", "surrogatepass")
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
