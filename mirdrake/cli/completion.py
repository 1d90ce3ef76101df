"""``mirdrake completion``: completion of verbs, options, names and ports in the shell."""

import argparse
import contextlib
import io
import re
from collections.abc import Iterable, Sequence

from mirdrake.core.errors import MirdrakeError
from mirdrake.core.paths import names

MORE = """\
Add the line to ~/.bashrc or ~/.zshrc. The Tab key then completes verbs, options, names of vehicles, worlds, diagrams
and studies, and the ports of a diagram.

examples:
  eval "$(mirdrake completion bash)"
  eval "$(mirdrake completion zsh)\""""

_BASH = """\
_mirdrake() {
  COMPREPLY=($(compgen -W "$(mirdrake completion bash --words "${COMP_WORDS[@]:1:COMP_CWORD}" 2>/dev/null)" \\
    -- "${COMP_WORDS[COMP_CWORD]}"))
}
complete -o default -F _mirdrake mirdrake
"""

_SCRIPTS = {"bash": _BASH, "zsh": f"autoload -U +X bashcompinit && bashcompinit\n{_BASH}"}

_FOLDERS = {
    "run": ("diagrams",),
    "draw": ("diagrams",),
    "ports": ("diagrams",),
    "drive": ("models", "worlds"),
    "inspect": ("models",),
    "check": ("models", "worlds", "diagrams", "studies"),
    "manoeuvre": ("models",),
    "validate": ("models",),
    "view": ("models", "worlds", "diagrams"),
    "study": ("studies",),
    "tune": ("studies",),
    "identify_run": ("studies",),
    "identify_apply": ("models",),
    "learn_clone": ("studies",),
    "world_check": ("worlds",),
    "world_build": ("worlds",),
    "world_show": ("worlds",),
    "world_test": ("worlds",),
    "world_search": ("worlds",),
}
"""Kinds of names that a verb takes, by its module; other verbs take files."""

_POSITIONAL = re.compile(r"(?m)^  \{([\w,-]+)\}")
"""Choices of an argument in the help of a verb."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("shell", choices=list(_SCRIPTS), help="the shell")
    parser.add_argument(
        "--words", nargs=argparse.REMAINDER, help="print the completions of these words, for the script"
    )


def run(options: argparse.Namespace) -> int:
    """Print the script, or the completions."""
    if options.words is None:
        print(_SCRIPTS[options.shell], end="")
    else:
        print("\n".join(completions(options.words)))
    return 0


def completions(words: Sequence[str]) -> list[str]:
    """Return what the last word may become.

    Args:
        words: words of the command line after ``mirdrake``; the last one is not complete and may be empty.
    """
    from mirdrake.cli import VERBS

    *before, last = words or [""]
    if not before:
        return _beginning(VERBS, last)
    # An unknown verb has no completions; the command itself reports it.
    verb = VERBS.get(before[0])
    if verb is None:
        return []
    choices: list[str] = [] if len(before) > 1 else list(verb.verbs)
    path = _path(before)
    if last.startswith("-"):
        return _beginning(_options(_help(path)), last)
    if before[-1].startswith("--"):
        values = _values(before, path)
        if values:
            return _beginning(values, last)
    if before[0] == "ports" and len(before) == 2:
        return _beginning(_ports(before[1]), last)
    if before[0] == "manoeuvre" and len(before) == 1:
        choices += _manoeuvres()
    # Names of files of the library, after what the verb itself offers; a verb with others below it takes none.
    module = verb.module if len(path) == 1 else verb.verbs[path[1]].module
    choices += [name for kind in _FOLDERS.get(module, ()) for name in names(kind)]
    return _beginning(choices or _positional_choices(_help(path)), last)


def _beginning(choices: Iterable[str], text: str) -> list[str]:
    return sorted({choice for choice in choices if choice.startswith(text)})


def _path(words: Sequence[str]) -> list[str]:
    """Return the verb of a command line, with the one below it that is named or applies by default."""
    from mirdrake.cli import VERBS

    verb = VERBS[words[0]]
    below = words[1] if len(words) > 1 and words[1] in verb.verbs else verb.default
    return [words[0], below] if below else [words[0]]


def _help(path: Sequence[str]) -> str:
    """Return the help of a verb."""
    from mirdrake.cli import VERBS
    from mirdrake.cli.verbs import VerbParser, add_verbs

    parser, text = VerbParser("mirdrake"), io.StringIO()
    add_verbs(parser, VERBS)
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(text):
        parser.parse_args([*path, "--help"])
    return text.getvalue()


def _options(text: str) -> list[str]:
    """Return the options in the help of a verb."""
    found = (word.strip("[],") for word in text.split())
    return [word for word in found if word.startswith("--") and len(word) > 2]


def _values(words: Sequence[str], path: Sequence[str]) -> list[str]:
    """Return the values that the last option takes: its choices, or the systems of the diagram that is named."""
    option = words[-1]
    if option == "--expand" and len(words) > 2:
        return sorted({".".join(name.split(".")[:2]) for name in _ports(words[1]) if ".control." in name})
    choices = re.search(rf"{re.escape(option)} \{{([^}}]*)\}}", _help(path))
    return choices[1].split(",") if choices else []


def _positional_choices(text: str) -> list[str]:
    """Return the choices of the arguments in the help of a verb."""
    return [choice for group in _POSITIONAL.findall(text) for choice in group.split(",")]


def _manoeuvres() -> list[str]:
    from mirdrake.manoeuvres.registry import MANOEUVRES

    return list(MANOEUVRES)


def _ports(diagram: str) -> list[str]:
    """Return the names of the ports of a diagram; none if it cannot be built."""
    from mirdrake.cli.common import assemble_for_display

    try:
        assembly, _ = assemble_for_display(diagram, [], trust=False)
    except MirdrakeError:
        return []
    return [*assembly.outputs, *assembly.inputs]
