"""XMP: what a file says of itself in XML (ISO 16684-1)."""

from __future__ import annotations

from xml.etree import ElementTree

__all__ = ["GPANO", "GSPHERICAL", "properties"]

GPANO = "http://ns.google.com/photos/1.0/panorama/"
GSPHERICAL = "http://ns.google.com/videos/1.0/spherical/"
LONGEST = 1 << 22  # bytes


def properties(xmp: bytes, namespace: str) -> dict[str, str]:
    """The simple properties of `namespace` in a packet, by name: attributes or elements. Empty if it is unreadable."""
    if len(xmp) > LONGEST or b"<!DOCTYPE" in xmp or b"<!ENTITY" in xmp:  # no XMP needs these, and they can be bombs
        return {}
    try:
        root = ElementTree.fromstring(xmp.strip(b"\0 \t\r\n"))
    except (ElementTree.ParseError, ValueError, LookupError):  # LookupError: an encoding that is not known
        return {}
    found, prefix = {}, f"{{{namespace}}}"
    for element in root.iter():
        pairs = [*element.items(), (element.tag, element.text or "")]
        found |= {name[len(prefix) :]: text.strip() for name, text in pairs if name.startswith(prefix)}
    return found
