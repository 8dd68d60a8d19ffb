"""Replies of H*Bench are read as the published patterns read them, but in time that grows with the text alone."""

import re

from hypothesis import given
from hypothesis import strategies as st
from strategies import HOSTILE

from eagor.lab.tasks.hstar.rules import parse_action

# The published parser's own patterns: they backtrack, for minutes on a model that repeats itself.
WHOLE = {
    "free_think": re.compile(r"<think>(?P<think>.*?)</think>\s*<answer>(?P<answer>.*?)</answer>\s*", re.DOTALL),
    "no_think": re.compile(r"<answer>(?P<answer>.*?)</answer>\s*", re.DOTALL),
    "grounding": re.compile(
        r"<think>\s*(?P<think><observation>.*?</observation>\s*<reasoning>.*?</reasoning>)\s*</think>\s*"
        r"<answer>(?P<answer>.*?)</answer>\s*",
        re.DOTALL,
    ),
}
ANSWER = {
    "free_think": re.compile(r"(?:<think>(?P<think>.*?)</think>)?.*?<answer>(?P<answer>.*?)</answer>", re.DOTALL),
    "grounding": WHOLE["grounding"],
}
PIECES = ["<think>", "</think>", "<answer>", "</answer>", "<observation>", "</observation>", "<reasoning>",
          "</reasoning>", " ", "\n", "a", "|", "rotate(1,2)", "<image>"]  # fmt: skip
GROUNDED = "<think><observation>a</observation><reasoning>b</reasoning></think><answer>c</answer>"


def published(text, form):
    text = text.replace("<image>", "")
    kept = WHOLE[form].fullmatch(text.strip())
    found = ANSWER[form].search(text) if form != "no_think" else kept
    if found is None:
        return "", [], kept is not None
    parts = found.groupdict()
    actions = [part.strip() for part in parts["answer"].split("|") if part.strip()]
    return parts.get("think") or "", actions[:1], kept is not None


@HOSTILE
@given(st.lists(st.sampled_from([*PIECES, GROUNDED]), max_size=14).map("".join), st.sampled_from(list(WHOLE)))
def test_replies_are_read_as_by_the_published_patterns(text, form):
    reply = parse_action(text, form)
    assert (reply.think_content, reply.actions, reply.format_correct) == published(text, form)


def test_a_model_that_repeats_itself_is_read_at_once():
    loops = ("</think><answer>", "<think><observation>a</observation><reasoning>b</reasoning></think>", "<answer>")
    for loop in loops:  # a quarter of an hour and more with the patterns above
        for form in WHOLE:
            assert parse_action("<think>" + loop * 3000, form).actions == []
