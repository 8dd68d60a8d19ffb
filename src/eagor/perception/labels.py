"""Which labels of a file of detections a query means."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress

from eagor.errors import QueryError
from eagor.perception.record_fields import words_of
from eagor.perception.words import RELATIONS, meant

__all__ = ["fitting"]

ARTICLES = {"a", "an", "the"}


def fitting(query: str, labels: Iterable[str]) -> frozenset[str]:
    """Those of `labels` that `query` means.

    A label that is the query itself wins. Otherwise a label fits if all its words occur in the query ("chair" and "red
    chair" fit "the big red chair"), or if the query means it by a plural, another name or a wider word ("fridge" means
    "refrigerator", `eagor.perception.words.meant`). What follows a preposition is left out: "the chair by the table"
    is no table.
    """
    known = tuple(dict.fromkeys(labels))
    asked = words_of(query)
    bare = [word for word in asked if word not in ARTICLES]
    exact = frozenset(label for label in known if words_of(label) in (asked, bare) and words_of(label))
    if exact:
        return exact
    place = next((at for at, word in enumerate(asked) if at and word in RELATIONS), len(asked))
    thing = set(asked[:place])
    named = {label for label in known if words_of(label) and thing.issuperset(words_of(label))}
    with suppress(QueryError):  # which says that the words mean none of them
        named.update(meant(query, known, described=True))
    return frozenset(named)
