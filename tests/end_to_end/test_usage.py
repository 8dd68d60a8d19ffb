"""Mistakes at the command line: one line with the nearest command or option. And what completes words in a shell."""

import shutil
import subprocess
import sys

import pytest

from eagor.cli import _parse, main


@pytest.fixture
def refused(capsys):
    """The one line on stderr, without its beginning; nothing on stdout, exit code 2."""

    def refused(words):
        assert main(words.split()) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith("eagor: error: ")
        assert len(err.splitlines()) == 1
        return err.removeprefix("eagor: error: ").rstrip("\n")

    return refused


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
def test_a_mistake_is_one_line_that_says_what_to_change(refused, words, says):
    assert says in refused(words)


def test_what_is_right_is_not_explained_away():
    """Values that look like options or commands still pass."""
    assert _parse(["locate", "track", "-5 degrees", "--stamp", "-3", "--degree=7"]).stamp == -3
    assert _parse(["bench", "run", "waypoint", "--set", "a=1", "b=2", "--json"]).action.set == ("a=1", "b=2")


def test_help_still_comes(capsys):
    assert main(["locate", "--help"]) == 0
    out, err = capsys.readouterr()
    assert "usage: eagor locate" in out
    assert err == ""


# --- completion ------------------------------------------------------------------------------------------------------


@pytest.fixture
def script(capsys):
    def script(shell):
        assert main(["--tyro-print-completion", shell]) == 0
        out, err = capsys.readouterr()
        assert err == ""
        return out

    return script


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_completion_script_is_printed_and_its_shell_accepts_it(script, shell, tmp_path):
    text = script(shell)
    assert "eagor" in text
    if shutil.which(shell):
        tmp_path.joinpath("script").write_text(text, encoding="utf-8")
        subprocess.run([shell, "-n", str(tmp_path / "script")], check=True, timeout=60)


@pytest.mark.skipif(not shutil.which("bash"), reason="no bash")
@pytest.mark.parametrize(
    ("words", "completed"),
    [("eagor loc", "locate"), ("eagor track --pos", "--poses"), ("eagor bench run --engine t", "threads")],
)
def test_bash_completes_commands_options_and_values(script, tmp_path, words, completed):
    tmp_path.joinpath("script").write_text(script("bash"), encoding="utf-8")
    asks = (
        'source "$0"; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMP_LINE="$*"; COMP_POINT=${#COMP_LINE}; '
        '_tyro_eagor eagor "${COMP_WORDS[COMP_CWORD]}"; echo "${COMPREPLY[@]}"'
    )
    tmp_path.joinpath("python3").symlink_to(sys.executable)
    done = subprocess.run(
        ["bash", "-c", asks, str(tmp_path / "script"), *words.split()],
        capture_output=True, text=True, timeout=60, env={"PATH": f"{tmp_path}:/usr/bin:/bin"},
    )  # fmt: skip
    assert done.stdout.strip() == completed, done.stderr
