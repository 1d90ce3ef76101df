"""Completion of the command line in the shell."""

import shutil
import subprocess
import sys

import pytest

from mirdrake.cli import main
from mirdrake.cli.completion import completions


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["dr"], {"drive", "draw"}),
        (["world", "sh"], {"show"}),
        (["run", "bolt_t"], {"bolt_test_track"}),
        (["drive", "bo"], {"bolt"}),
        (["draw", "bolt_test_track", "--ex"], {"--expand"}),
        (["world", "test", "--jo"], {"--jobs"}),
        (["ports", "bolt_test_track", "ego.control.speed_pid.o"], {"ego.control.speed_pid.output"}),
        (["draw", "bolt_test_track", "--expand", ""], {"ego.control"}),
        (["drive", "bolt", "--contact", "h"], {"hydroelastic"}),
        (["manoeuvre", "brak"], {"braking"}),
        (["completion", "z"], {"zsh"}),
        (["check", "bolt_sk"], {"bolt_skidpad"}),
        (["nothing", "x"], set()),
    ],
)
def test_words_are_completed(words, expected):
    assert expected <= set(completions(words))
    assert all(word.startswith(words[-1]) for word in completions(words))


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["world", "e"], ["edit"]),
        (["world", "test", "em"], ["empty"]),
        (["world", "import", "em"], []),
        (["tune", "bolt_sp"], ["bolt_speed"]),
        (["tune", "apply", "bolt_sp"], []),
        (["learn", "clone", "clone_b"], ["clone_bolt"]),
        (["identify", "identify_t"], ["identify_two_track"]),
        (["learn", "clone_b"], []),
    ],
)
def test_names_are_completed_where_the_verb_takes_them(words, expected):
    assert completions(words) == expected


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_with_the_script(capsys):
    main(["completion", "bash"])
    script = capsys.readouterr().out
    program = f'mirdrake() {{ {sys.executable} -c "from mirdrake.cli import main; main()" "$@"; }}'
    words = "COMP_WORDS=(mirdrake run bolt_t); COMP_CWORD=2; _mirdrake; echo ${COMPREPLY[@]}"
    done = subprocess.run(["bash", "-c", f"{program}\n{script}\n{words}"], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["bolt_test_track"]


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_the_script_is_valid(capsys):
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0
    assert "complete -o default -F _mirdrake mirdrake" in script
