"""Mistakes at the command line: one line with the nearest command or option. And what completes words in a shell."""

import shutil
import subprocess
import sys
import typing

import pytest

from eagor.cli import _parse, commands, main
from eagor.cli.commands import Command


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
        ("locat", "unknown command 'locat'; did you mean locate? eagor --help describes all"),
        ("Track a b", "unknown command 'Track'; did you mean track?"),
        ("bench rum", "unknown command 'rum'; did you mean run? eagor bench --help describes all"),
        ("models install coco", "unknown command 'install'; wanted list or get; eagor models --help"),
        ("chair", "unknown command 'chair'; wanted locate, look, track, "),
        ("--json locate a b", "--json stands before the command; options follow it: eagor locate ... --json"),
        ("--jsn", "--jsn is no command; wanted locate, look, track, "),
        ("", "eagor needs a command: locate, look, track, "),
        ("bench", "eagor bench needs a command: run, report, "),
        (
            "track x y --pose p.csv",
            "eagor track has no option --pose; did you mean --poses? eagor track --help describes",
        ),
        ("locate a b --perceptoin colour", "eagor locate has no option --perceptoin; did you mean --perception?"),
        ("bench run waypoint --retry_faild", "no option --retry-faild; did you mean --retry-failed?"),
        ("bench run waypoint --sead=3", "eagor bench run has no option --sead; did you mean --seed?"),
        ("locate a b --drift 1", "eagor locate has no option --drift: it belongs to eagor track, eagor live"),
        ("locate a b --zzz", "eagor locate has no option --zzz; eagor locate --help describes all"),
        ("locate a b -x", "eagor locate has no option -x"),
        ("locate a b --degree", "--degree needs a value: --degree N; eagor locate --help"),
        ("locate a b --degree --json", "--degree needs a value: --degree N"),
        ("locate a b --degree fifteen", "--degree fifteen: wanted a whole number"),
        ("locate a b --degree=1.5", "--degree 1.5: wanted a whole number"),
        ("locate a b --stamp now", "--stamp now: wanted a number"),
        ("bench run waypoint --engine foo", "--engine foo: wanted processes, threads or ray"),
        ("calibrate all", "WHAT 'all': wanted responses or heads"),
        ("locate", "eagor locate needs PICTURE QUERY; eagor locate --help"),
        ("models get", "eagor models get needs NAME; eagor models get --help"),
        ("locate a.png", "eagor locate needs PICTURE QUERY, and lacks QUERY"),
        ("locate a.png red chair", "got 'chair' too. Write a query of several words in quotes: \"red chair\""),
        ("doctor please", "eagor doctor takes no 'please', only options"),
        ("--tyro-print-completion", "--tyro-print-completion needs a shell: bash, zsh or fish"),
        ("--tyro-print-completion tcsh", "--tyro-print-completion needs a shell: bash, zsh or fish"),
    ],
)
def test_a_mistake_is_one_line_that_says_what_to_change(refused, words, says):
    assert says in refused(words)


def test_a_file_in_place_of_a_command(refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tmp_path.joinpath("room.jpg").touch()
    tmp_path.joinpath("frames").mkdir()
    tmp_path.joinpath("clip.MP4").touch()
    assert "did you mean eagor locate room.jpg ...?" in refused("room.jpg chair")
    assert "did you mean eagor track frames ...?" in refused("frames chair")
    assert "did you mean eagor track clip.MP4 ...?" in refused("clip.MP4 chair")


def test_what_cannot_be_explained_is_left_to_tyro(monkeypatch, capsys):
    monkeypatch.setattr(commands, "mistake", lambda _: None)
    assert main(["locate"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "eagor locate --help" in err


def leaves(union, path=()):
    """The words of every command."""
    for member in typing.get_args(union):
        kind, *about = typing.get_args(member)
        name = next(each.name for each in about if hasattr(each, "name"))
        hints = typing.get_type_hints(kind, include_extras=True)
        if "action" in hints:
            yield from leaves(typing.get_args(hints["action"])[0], (*path, name))
        else:
            yield (*path, name)


@pytest.mark.parametrize("words", [*leaves(Command)], ids=" ".join)
def test_every_command_can_be_explained(refused, words):
    says = refused(" ".join([*words, "--no-such-option", "3"]))
    assert f"eagor {' '.join(words)} has no option --no-such-option" in says


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
    if shell == "bash":
        assert "complete -o default -F" in text
    if shell == "fish":
        assert "--no-files" not in text
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
