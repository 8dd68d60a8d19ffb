"""Words and what they name."""

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eagor.errors import QueryError
from eagor.queries import COLOURS, SYNONYMS, Query, matching, parse_query

CATEGORIES = [
    "chair", "armchair", "sofa", "bed", "table", "coffee table", "desk", "nightstand", "dresser", "wardrobe",
    "bookshelf", "tv", "plant", "lamp", "ceiling lamp", "toilet", "sink", "bathtub", "refrigerator", "stove", "cabinet",
    "rug", "painting", "vase", "wall", "floor", "door", "window",
]  # fmt: skip


@dataclass(frozen=True)
class Thing:
    category: str
    colour: str | None = None


queries = st.builds(Query, st.sampled_from(CATEGORIES), st.none() | st.sampled_from(COLOURS))
things = st.builds(Thing, st.sampled_from(CATEGORIES), st.none() | st.sampled_from(COLOURS))


@given(queries, st.sampled_from(["{}", "the {}", "a {}", "The {}!", "my  {} ", "THE {}.", "{}s"]))
def test_a_query_in_words_reads_back(query, phrase):
    assert parse_query(phrase.format(query), CATEGORIES) == query


@given(queries, st.lists(things))
def test_what_matches_is_of_the_category_and_the_colour(query, scene):
    found = matching(query, scene)
    assert found == sorted(set(found))
    for place, thing in enumerate(scene):
        wanted = thing.category == query.category and (query.colour is None or thing.colour == query.colour)
        assert (place in found) == query.matches(thing) == wanted


@pytest.mark.parametrize(
    ("word", "meant"), [(word, meant) for word, meant in SYNONYMS.items() if meant not in COLOURS], ids=str
)
def test_other_names_mean_the_same(word, meant):
    for phrase in (word, f"the {word}", f"{word}s", f"grey {word}", f"GRAY {word.upper()}"):
        query = parse_query(phrase, CATEGORIES)
        assert query.category == meant
        assert query.colour == ("grey" if "gr" in phrase.lower().split()[0] else None)


def test_synonyms_lead_to_names_and_not_on_to_synonyms():
    assert not set(SYNONYMS.values()) & set(SYNONYMS)
    assert not set(SYNONYMS) & set(COLOURS)


@given(st.text(max_size=30) | st.none() | st.integers())
def test_any_text_is_a_query_or_a_query_error(text):
    try:
        query = parse_query(text, CATEGORIES)
    except QueryError:
        return
    assert query.category in CATEGORIES
    assert query.colour in (None, *COLOURS)


@pytest.mark.parametrize("text", ["", "red", "the", "red red chair", "chair and table", "chairman"])
def test_half_a_query_is_refused(text):
    with pytest.raises(
        QueryError, match=r"Wanted '\[colour\] category'; categories: armchair, bathtub, .*colours: bla"
    ):
        parse_query(text, CATEGORIES)


@pytest.mark.parametrize(
    ("text", "hint"), [("chiar", "chair"), ("red soffa", "sofa"), ("tois", "toilet"), ("colffee table", "coffee table")]
)
def test_a_near_miss_gets_a_hint(text, hint):
    with pytest.raises(QueryError, match=f"Did you mean '{hint}'"):
        parse_query(text, CATEGORIES)


def test_what_is_known_decides():
    assert parse_query("red chair", ["chair"]) == Query("chair", "red")
    with pytest.raises(QueryError, match="categories: sofa"):
        parse_query("red chair", ["sofa"])
    with pytest.raises(QueryError):
        parse_query("chair", [])
