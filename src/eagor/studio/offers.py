"""What the studio can look with: perceptions by name, whether each is ready here, and what it suits."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

from eagor._extras import how_to_install
from eagor.perception import short_name

__all__ = ["Offer", "offers"]

WALK, PICTURE = "walk", "picture"
_BUILT_IN = {
    "scout": ("a small network for the rendered apartments", (WALK,)),
    "truth": ("told by the simulator, with a detector's mistakes", (WALK,)),
    "coco": ("a small network for 80 everyday things in photographs", (PICTURE,)),
    "colour": ("where the colour is that the query names", (WALK, PICTURE)),
}


@dataclass(frozen=True)
class Offer:
    """A perception: its `name` for opening, and `words` about it; `problem`: why it is not `ready` (else empty)."""

    name: str
    words: str
    views: tuple[str, ...]
    ready: bool = True
    problem: str = ""


def offers(given: str | None = None) -> list[Offer]:
    """The built-in ones, and the `given` one of the command line first."""
    found = [Offer(name, words, views, not (why := _missing(name)), why) for name, (words, views) in _BUILT_IN.items()]
    if given is None or given in _BUILT_IN:
        return sorted(found, key=lambda offer: offer.name != given)
    return [Offer(given, f"{short_name(given)}, given with --perception", (WALK, PICTURE)), *found]


def _missing(name: str) -> str:
    if name == "coco":
        from eagor.perception.coco import COCO

        if not COCO.path.is_file():
            return "Its weights are not here: run eagor models get coco, then reload the page."
        if find_spec("onnxruntime") is None:
            return f"It needs onnxruntime: {how_to_install('photos')}"
    if name in ("scout", "truth"):
        lacking = [each for each in ("onnxruntime", "trimesh", "gymnasium") if find_spec(each) is None]
        if lacking:
            return f"It needs {' and '.join(lacking)}: {how_to_install('sim')}"
    return ""
