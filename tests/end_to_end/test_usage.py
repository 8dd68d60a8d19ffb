"""Mistakes at the command line: one line with the nearest command or option."""

import pytest
from commands import eagor, refused

from eagor.cli import _parse


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("locat", "Unrecognized options: locat"),
        ("chair", "Unrecognized options: chair"),
        ("models get", "Missing from eagor models get: NAME"),
        ("locate a.png", "Missing from eagor locate: QUERY What to look for, in words."),
        ("track x y --pose p.csv", "Unrecognized options: --pose, p.csv; did you mean --poses?"),
        ("locate a b --perceptoin colour", "did you mean --perception?; eagor --help describes all"),
        ("locate a b --degree", "--degree"),
        ("locate a b --degree fifteen", "Error parsing --degree: invalid literal for int() with base 10: 'fifteen'"),
        ("bench run waypoint --engine foo", "--engine"),
        ("--tyro-print-completion", "--tyro-print-completion needs a shell: bash, zsh, fish"),
        ("--tyro-print-completion tcsh", "--tyro-print-completion needs a shell: bash, zsh, fish"),
    ],
)
def test_a_mistake_is_one_line_that_says_what_to_change(words, says):
    assert says in refused(*words.split())


def test_what_is_right_is_not_explained_away():
    """Values that look like options or commands still pass."""
    assert _parse(["locate", "track", "-5 degrees", "--stamp", "-3", "--degree=7"]).stamp == -3
    assert _parse(["bench", "run", "waypoint", "--set", "a=1", "b=2", "--json"]).action.set == ("a=1", "b=2")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_completion_script_is_printed(shell):
    done = eagor("--tyro-print-completion", shell)
    assert (done.returncode, done.stderr) == (0, "")
    assert "eagor" in done.stdout
    assert ("complete -o default -F" in done.stdout) == (shell == "bash"), "files are completed everywhere"
