"""Videos for tests: encoded here by PyAV, and boxes and trailers put into them by hand."""

from __future__ import annotations

import io
import struct
from fractions import Fraction

import av
import numpy as np

from eagor.errors import EagorError
from eagor.lab.worlds.painted import painted_room

ROOM = painted_room(64, 128)
HEADERS = {b"stsd": 8, b"avc1": 78, b"mp4v": 78}  # bytes before the boxes inside


def rolled(count, image=ROOM):
    """`count` pictures, each rolled by one column more."""
    return [np.ascontiguousarray(np.roll(image, k, axis=1)) for k in range(count)]


def clip(path, pictures=None, *, rate=30, codec="libx264", times=None, options=None, pix_fmt="yuv420p", container=None):
    """Write `pictures` (30 by default); `times`: milliseconds of each, or `rate` a second."""
    pictures = rolled(30) if pictures is None else pictures
    with av.open(str(path), "w", format=container) as container:
        stream = container.add_stream(codec, rate=rate)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = pix_fmt
        stream.options = {"g": "10", "bf": "2"} | (options or {}) if codec == "libx264" else options or {}
        if times is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        for k, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            if times is not None:
                frame.pts, frame.time_base = times[k], Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def taken(video):
    """The pictures that come, and the error at the end."""
    frames = []
    try:
        for frame in video:
            frames.append(frame)
    except EagorError as error:
        return frames, error
    return frames, None


def box(kind, *parts):
    body = b"".join(parts)
    return struct.pack(">I4s", 8 + len(body), kind) + body


def full(kind, *parts):
    return box(kind, bytes(4), *parts)


def edited(data, path, edit):
    """`data`, a row of boxes, with `edit` applied to the content of the first box at `path`."""
    at, out, done = 0, io.BytesIO(), False
    while at + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8 : at + length]
        if kind == path[0] and not done:
            done = True
            skip = HEADERS.get(kind, 0)
            body = edit(body) if len(path) == 1 else body[:skip] + edited(body[skip:], path[1:], edit)
        out.write(box(kind, body))
        at += length
    assert done, f"there is no {path[0]}"
    return out.getvalue()


def into(path, place, edit):
    """Apply `edit` to the content of the box at `place` of a file, in which the index comes last."""
    path.write_bytes(edited(path.read_bytes(), place, edit))
    return path


def first(data, kind):
    """The first box of a kind, whole."""
    at = 0
    while data[at + 4 : at + 8] != kind:
        at += struct.unpack_from(">I", data, at)[0]
    return data[at : at + struct.unpack_from(">I", data, at)[0]]


ENTRY = [b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"avc1"]


def sv3d(kind=b"equi", yaw=0.0, pitch=0.0, roll=0.0, bounds=(0.0, 0.0, 0.0, 0.0)):
    """Spherical Video V2; angles in degrees, bounds as shares: top, bottom, left, right."""
    pose = struct.pack(">iii", *(round(angle * 65536) for angle in (yaw, pitch, roll)))
    inside = struct.pack(">IIII", *(round(share * 2**32) for share in bounds)) if kind == b"equi" else bytes(8)
    return box(b"sv3d", full(b"svhd", b"test\0"), box(b"proj", full(b"prhd", pose), full(kind, inside)))


def st3d(mode):
    return full(b"st3d", bytes([mode]))


def with_entry(path, *boxes):
    """Boxes in the entry of the picture track."""
    return into(path, ENTRY, lambda body: body + b"".join(boxes))


TRACK = (0x18538067, 0x1654AE6B, 0xAE, 0xE0)  # Segment, Tracks, TrackEntry, Video


def element(name, body):
    """An element of Matroska, its length in eight bytes."""
    return name.to_bytes((name.bit_length() + 7) // 8) + (len(body) | 1 << 56).to_bytes(8) + body


def with_element(path, added, place=TRACK):
    """An element more in the description of the picture track of a Matroska file."""
    path.write_bytes(_with_element(path.read_bytes(), added, place))
    return path


def _with_element(data, added, place):
    if not place:
        return data + added
    out, at = b"", 0
    while at < len(data):
        name, start = _ebml(data, at)
        marked, body = _ebml(data, start)
        length = marked - (1 << 7 * (body - start))
        inside = data[body : body + length]
        if name == place[0]:
            out += element(name, _with_element(inside, added, place[1:]))
        elif name != 0xBF:  # a checksum of what changes
            out += data[at : body + length]
        at = body + length
    return out


def _ebml(data, at):
    """A number with its marker, and where it ends."""
    end = at + 9 - data[at].bit_length()
    return int.from_bytes(data[at:end]), end


def trailer(rows, *, camera="Insta360 Test", first=0, raw=False):
    """An Insta360 trailer; `rows`: (seconds, acceleration in g (3), radians per second (3)), in the IMU's axes."""
    samples = io.BytesIO()
    for time, felt, rates in rows:
        if raw:
            values = [32768 + round(v / 16 * 32768) for v in felt]
            values += [32768 + round(np.degrees(v) / 2000 * 32768) for v in rates]
            samples.write(struct.pack("<Q6H", round(time * 1e6) + first, *values))
        else:
            samples.write(struct.pack("<Q6d", round(time * 1e3) + first, *felt, *rates))
    about = b"\x12" + bytes([len(camera)]) + camera.encode() + b"\xc0\x01" + _varint(first)
    about += (b"\xf0\x03\x01" + b"\x8a\x04\x05\x08\x10\x10\xd0\x0f") if raw else b""  # fields 62 and 65
    body = b""
    for format_, kind, data in ((1, 1, about), (0, 3, samples.getvalue())):
        body += data + struct.pack("<BBI", format_, kind, len(data))
    return body + bytes(32) + struct.pack("<II", len(body) + 72, 3) + b"8db42d694ccc418790edff439fe026bf"


def _varint(value):
    out = b""
    while value > 127:
        out += bytes([value & 127 | 128])
        value >>= 7
    return out + bytes([value])
