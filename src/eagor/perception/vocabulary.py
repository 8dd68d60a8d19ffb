"""Which classes of a detector a query means, and which of its labels: articles, plurals, compounds, other names.

A detector with a closed set of classes knows no colours and no relations: `match_class` refuses a query with one, and
suggests the noun alone; `eagor.perception.views` takes colours, and weighs boxes by them. One with an open vocabulary
writes what it likes: `fitting` is the rule for its labels, live and recorded. The tables are in vocabulary.toml.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from msgspec import toml

from eagor._extras import how_to_install
from eagor.errors import QueryError
from eagor.evidence import Evidence
from eagor.perception.colour import COLOURS, SYNONYMS, Colour, colour_in, is_colour

__all__ = [
    "by_colour_alone", "colour_of", "contradicts", "fitting", "for_any_words", "is_bare_colour", "listed",
    "match_class", "named", "plain", "same_name", "singular",
]  # fmt: skip

_TABLES = toml.decode(Path(__file__).with_name("vocabulary.toml").read_bytes())


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(","))


# Every name to the names that mean the same.
GROUPS = {name: group for group in map(_names, _TABLES["groups"].strip().splitlines()) for name in group}
OTHER_THINGS = frozenset(_TABLES["other_things"].strip().splitlines())  # not what their last word is
OPENERS, DESCRIBING = frozenset(_TABLES["openers"].split()), frozenset(_TABLES["describing"].split())
DRINKING: list[str] = _TABLES["drinking"].split()
IRREGULAR: dict[str, str] = _TABLES["irregular"]
# What the thing is among classes that are finer, or coarser, than the word.
WIDER: dict[str, tuple[str, ...]] = {wide: _names(kinds) for wide, kinds in _TABLES["wider"].items()} | {
    narrow: (wide,) for wide, words in _TABLES["narrower"].items() for narrow in words.split()
}
RELATIONS = frozenset(
    """on in at by near next beside behind under above below between with without to from over inside outside against
    around that which who""".split()  # noqa: SIM905
)
_ANYTHING = {"something", "anything", "thing", "things", "stuff"}
_HOLDING = {"cup", "glass", "mug", "bottle", "bowl", "vase", "box", "can", "jar", "pot"}  # a cup of tea is a cup
_PARTS = {"slice", "piece", "pair", "bunch", "group", "kind", "sort", "couple"}  # a slice of pizza is pizza
# What detectors of an open vocabulary are asked with, and label with: "a photo of a chair", "an image of the chair".
_PROMPT = re.compile(
    r"\A(?:(?:this|here|it|is|an?|the|one|my|good|bad|cropped|blurry|clean|bright|dark|low|high|resolution|quality) )*"
    r"(?:photo|photograph|picture|image|rendering|itap|close up) of (?=\S)"
)
_NEGATIVE = {"no", "not", "without", "non"}
_EVERY = 8  # classes that an error names
_MOST_LABELS = 8  # in a warning
_ROOMS = ("chair", "couch", "bed", "dining table", "tv", "refrigerator", "potted plant", "person")


def match_class(
    query: str, classes: Sequence[str], *, described: bool = False, coloured: bool = False
) -> tuple[str, ...]:
    """The names among `classes` that `query` means, as they are spelt there and in their order.

    A class's own name wins over its other names, those over wider words ("animal" means every animal that is there),
    and those over the last word of a compound ("office chair" means a chair). `described`: leave out words that
    describe ("red", "wooden", "by the window") instead of refusing them; `coloured`: leave out words for colours alone.

    Raises `QueryError` for a word that no class fits, which names the nearest classes; for words that describe, as a
    detector with a closed set of classes finds every chair, not the red one; and for a query without words.
    """
    words = plain(query).split() if isinstance(query, str) else []
    if not words:
        raise QueryError(f"the query {query!r} has no words; say what to look for, such as {_some(classes)}")
    found, noun, left_out = _looked_up(tuple(words), tuple(classes))
    if found and (not left_out or described or (coloured and is_colour(" ".join(left_out)))):
        return found
    any_words = f"To look for any words: {for_any_words()}"
    if COLOURS.keys() >= {*(words := _asked(words))}:
        raise QueryError(
            f"the query {query!r} names a colour and no thing; this detector does not know colours. It knows "
            f"{_some(classes)}. --perception colour finds what is of a colour. {any_words}"
        )
    if found:
        what = "words such as" if COLOURS.keys().isdisjoint(left_out) else "colours, such as"
        raise QueryError(
            f"the query {query!r}: this detector does not know {what} {' '.join(left_out)!r}; it finds every "
            f"{' or '.join(found)}. Ask for {' '.join(noun)!r} alone. {any_words}"
        )
    near = ", ".join(nearest(" ".join(noun or words), classes))
    hint = f"the nearest that it knows: {near}" if near else f"it knows {_some(classes)}, and none spelt like it"
    raise QueryError(
        f"the query {query!r} names none of this detector's {len(classes)} classes; {hint}. "
        f"{any_words}{by_colour_alone(query, classes)}"
    )


@lru_cache(maxsize=4096)
def _looked_up(asked: tuple[str, ...], classes: tuple[str, ...]) -> tuple[tuple[str, ...], list[str], list[str]]:
    """The classes that the words mean, their noun, and the words that describe it.

    By name, by another name, by a wider word; then by fewer and fewer of the last words.
    """
    found, words = _named(" ".join(asked), classes), _asked([*asked])  # whatever it is, a class is called so
    if found := found or _called(" ".join(words), classes):
        return found, words, []
    noun, left_out = _noun(words)
    for at in range(len(noun)) if "of" not in noun else ():
        name = " ".join(noun[at:])
        # A car seat is no couch.
        if singular(name) in OTHER_THINGS or (at and len(WIDER.get(singular(name), "1")) > 1):
            break
        if found := _called(name, classes):
            return found, noun, left_out
    return (), noun, left_out


def colour_of(query: str, classes: Sequence[str]) -> Colour | None:
    """The colour by which `query` tells a thing of these classes from others; none of "the orange" and "hot dog"."""
    return colour_in(" ".join(_looked_up(tuple(plain(query).split()), tuple(classes))[2]))


def named(evidence: Evidence, query: str, names: Collection[str]) -> Evidence:
    """`evidence` that names what was looked for instead of `query`, of which these classes or labels are meant.

    That is "chair" for "footstool"; nothing where one of them is the word that was asked, whatever its article, number
    or colour.
    """
    noun = " ".join(_looked_up(tuple(plain(query).split()), tuple(names))[1])
    if not names or _named(plain(query), names) or _named(noun, names):
        return evidence
    rest = len(names) - _EVERY
    words = " or ".join([*names][:_EVERY]) + (f" or {rest} more" if rest > 0 else "")
    return replace(evidence, looked_for=words)


def is_bare_colour(query: str, classes: Sequence[str]) -> bool:
    """Whether `query` names a colour and no thing, as "red" and "something red" do; "the orange" may be a class."""
    words = plain(query).split()
    anything = not _ANYTHING.isdisjoint(words)
    rest = " ".join(word for word in words if word not in OPENERS and word not in _ANYTHING)
    return is_colour(rest) and (anything or not _looked_up((*words,), (*classes,))[0])


def by_colour_alone(query: str, classes: Sequence[str]) -> str:
    """How to look for the colour of `query` alone, to end an error with; "" where it names none beside the noun."""
    if not plain(query) or colour_of(query, classes) is None:
        return ""
    return ". For all that has the colour, whatever it is: --perception colour"


def fitting(query: str, labels: Iterable[str], wanted: Collection[str] | None = None) -> frozenset[str]:
    """Those of `labels` that may be what `query` asks for: the one rule for detectors that take any words.

    `wanted`: the classes that the query means, of a detector that has some: the labels that name these.

    Articles, prompts ("a photo of a chair"), plurals and signs do not matter. A label that is the query itself wins.
    Otherwise a label fits that names the query's thing, by another name, or more widely or narrowly, too ("fridge" and
    "refrigerator", "person" and "woman"), unless both name colours, and none in common: "chair" and "office chair" fit
    "red chair", "blue chair" does not. What follows a preposition is left out: "the chair by the table" is no table. A
    label without words says nothing against its box, and fits. Numbers behind a label ("chair 0.87") do not matter
    where the query has none.
    """
    if wanted is not None:
        return frozenset(label for label in labels if same_name(label, wanted))
    asked, known = _bare(query), {label: _bare(label) for label in labels}
    if not any(word.isdigit() for word in asked):
        known = {label: _unnumbered(words) for label, words in known.items()}
    noun = " ".join(_noun(asked)[0])
    exact = any(_same(words, asked) for words in known.values())

    def fits(words: list[str]) -> bool:
        if not words or _same(words, asked):
            return True
        if _contradict(words, asked):
            return False
        name = " ".join(words)
        more = _noun(words)[0][-1:] == _noun(asked)[0][-1:] and {*asked} <= {*words}
        narrower = more or (not exact and _looked_up(tuple(words), (noun,))[0])
        # A thing by itself is not the noun that it ends with: a teddy bear is no bear.
        group = GROUPS.get(singular(name), ())
        other = singular(name) in OTHER_THINGS or (bool(group) and singular(noun) not in group)
        return bool((narrower and not other) or (not exact and _looked_up(tuple(asked), (name,))[0]))

    return frozenset(label for label, words in known.items() if fits(words))


def listed(labels: Collection[str]) -> str:
    """Labels for a warning: the first `_MOST_LABELS`, in quotes."""
    return ", ".join(map(repr, sorted(labels)[:_MOST_LABELS])) + ", ..." * (len(labels) > _MOST_LABELS)


def contradicts(label: str, query: str) -> bool:
    """Whether a label says that its box is not what `query` asks for: "no chair", and "blue chair" for "red chair"."""
    words, asked = _bare(label), _bare(query)
    return bool(words) and not _same(words, asked) and _contradict(words, asked)


def _contradict(words: list[str], asked: list[str]) -> bool:
    own, colours = _colours(words), _colours(asked)
    return words[0] in _NEGATIVE or bool(own and colours and own.isdisjoint(colours))


def same_name(label: str, classes: Collection[str]) -> bool:
    """Whether a label is one of the `classes`, as it is or without article, prompt, plural, case and signs."""
    return label in classes or any(_same(_bare(label), _bare(each)) for each in classes)


def _same(words: list[str], others: list[str]) -> bool:
    return bool(words) and singular(" ".join(words)) == singular(" ".join(others))


def _unnumbered(words: list[str]) -> list[str]:
    """Without the score or the count behind a label."""
    last = next((at for at in range(len(words), 1, -1) if not words[at - 1].isdigit()), 1)
    return words[:last]


def _bare(text: str) -> list[str]:
    """The words of a query or of a label, without the prompt and the article before them."""
    return _asked(_PROMPT.sub("", plain(text)).split())


def _colours(words: list[str]) -> set[str]:
    """The colours of the thing, each by one name."""
    place = next((at for at, word in enumerate(words) if at and word in RELATIONS), len(words))
    return {SYNONYMS.get(word, word).rpartition(" ")[2] for word in words[: place - 1]} & COLOURS.keys()


def for_any_words() -> str:
    """What to type to look for things that a closed set of classes lacks: a model with an open vocabulary."""
    first = "" if find_spec("transformers") else f"{how_to_install('vlm')}; then "
    return (
        f"{first}--perception google/owlv2-base-patch16-ensemble; or a model on a server, --perception "
        "endpoint:MODEL@ADDRESS"
    )


def plain(text: str) -> str:
    """`text` in small letters, words with one space between them: ``"Television_Set"`` is ``"television set"``."""
    text = re.sub(r"['’]s?\b", "", str(text).casefold())
    return " ".join(re.findall(r"[^\W_]+", text))


@lru_cache(maxsize=4096)
def singular(words: str) -> str:
    """The last of `words` in the singular; "glass", "bus" and "scissors" stay as they are."""
    first, _, word = words.rpartition(" ")
    if word == "glasses" and first.rpartition(" ")[2] in DRINKING:
        word = "glass"
    elif word in IRREGULAR:
        word = IRREGULAR[word]
    elif word not in IRREGULAR.values() and len(word) > 3 and re.search(r"[^sui]s\Z", word):
        es = re.search(r"(?:ch|sh|ss|x|z|o)es\Z", word)
        word = f"{word[:-3]}y" if word.endswith("ies") and len(word) > 4 else word[: -2 if es else -1]
    return f"{first} {word}".strip()


def _asked(words: list[str]) -> list[str]:
    """Without "where is the" and the like before it."""
    while len(words) > 1 and words[0] in OPENERS:
        words = words[1:]
    return words


def _noun(words: list[str]) -> tuple[list[str], list[str]]:
    """The noun and what stands before its last word; and the words that describe it, which were taken off."""
    left_out: list[str] = []
    for at in range(1, len(words)):
        if words[at] in RELATIONS:
            words, left_out = words[:at], words[at:]
            break
        if words[at] == "of":  # but a picture of a dog is no dog
            head, rest = singular(words[at - 1]), _asked(words[at + 1 :])
            words = words[:at] if head in _HOLDING else rest if head in _PARTS and rest else words
            break
    while len(words) > 1 and (words[0] in DESCRIBING or words[0] in COLOURS):
        left_out, words = [*left_out, words[0]], _asked(words[1:])
    return words, left_out


def _called(name: str, classes: Sequence[str]) -> tuple[str, ...]:
    """The classes by their name, by another of it, or by a wider word, each by any of its names."""
    if found := _by_name(name, classes):
        return found
    for way in (name, singular(name), *_alike(name)):
        kinds = {each for kind in WIDER.get(way, ()) for each in _by_name(kind, classes)}
        if kinds:
            return tuple(each for each in dict.fromkeys(classes) if each in kinds)
    return ()


def _by_name(name: str, classes: Sequence[str]) -> tuple[str, ...]:
    """The classes that are called so, else those of the nearest other name for it."""
    return next(filter(None, (_named(same, classes) for same in (name, *_alike(name)))), ())


def _alike(name: str) -> tuple[str, ...]:
    return (*GROUPS.get(name, ()), *GROUPS.get(singular(name), ()))


def _named(name: str, classes: Collection[str]) -> tuple[str, ...]:
    """The classes that are called `name`, in the singular or as written."""
    ways = _spelt(tuple(classes))
    names = (name, singular(name), singular(name).replace(" ", ""))
    return next((ways[way] for way in names if way in ways), ())


@lru_cache(maxsize=64)
def _spelt(classes: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """The classes by what they are called: ``"Monitor/TV"`` is a monitor, a tv, and both; ``"bow (weapon)"`` a bow."""
    exact: dict[str, list[str]] = {}
    parts: dict[str, list[str]] = {}
    for each in classes:
        whole = plain(each)
        for way in {whole, singular(whole), whole.replace(" ", "")}:
            exact.setdefault(way, []).append(each)
        without = re.sub(r"\([^)]*\)", "", each)
        bare = " ".join(_asked(whole.split()))  # "a red chair", as detectors of an open vocabulary are given classes
        for part in map(plain, [bare, without, *re.split(r"[/;,|]", without)]):
            for way in {part, singular(part)} - {""}:
                parts.setdefault(way, []).append(each)
    return {way: tuple(dict.fromkeys(names)) for way, names in (parts | exact).items()}


def nearest(name: str, classes: Sequence[str], most: int = 5) -> tuple[str, ...]:
    """The classes nearest to `name`: those spelt alike, by any of their names, and those with its last word."""
    name = singular(plain(name))
    by_way = dict.fromkeys([*_spelt(tuple(classes)), *(other for other in GROUPS if _by_name(other, classes))])
    alike = difflib.get_close_matches(name, by_way, n=3, cutoff=0.8)  # a lower one takes a wall for a ball
    found = [each for way in alike for each in _by_name(way, classes)]
    found += [each for each in classes if name.rpartition(" ")[2] in plain(each).split()]
    return tuple(dict.fromkeys(found))[:most]


def _some(classes: Sequence[str]) -> str:
    """Some of the classes, those of rooms first, and how many more there are."""
    shown = [*dict.fromkeys([each for kind in _ROOMS for each in _named(kind, classes)] + [*classes])][:_EVERY]
    rest = len(classes) - len(shown)
    return ", ".join(shown) + (f" and {rest} more" if rest > 0 else "")
