"""Print a script that makes a shell complete verbs and options.

In bash: eval "$(hallway completion bash)"; zsh and fish alike.
"""

import argparse
import shlex
from dataclasses import dataclass

SHELLS = ("bash", "zsh", "fish")

_BASH = """\
_hallway() {{
    local cur="${{COMP_WORDS[COMP_CWORD]}}" words=""
    if [ "$COMP_CWORD" -eq 1 ]; then
        COMPREPLY=($(compgen -W "{verbs} --help --version" -- "$cur"))
        return
    fi
    case "${{COMP_WORDS[1]}}" in
{cases}
    esac
    COMPREPLY=($(compgen -W "$words" -- "$cur"))
    case "$cur" in -*) ;; *) COMPREPLY+=($(compgen -f -- "$cur")) ;; esac
}}
complete -o filenames -F _hallway hallway
"""


@dataclass(frozen=True, slots=True)
class Verb:
    """What can follow one verb."""

    name: str
    help: str
    words: tuple[str, ...]
    """Options, fixed choices and names of graphs, in the order in which the help shows them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("shell", choices=SHELLS)


def run(args: argparse.Namespace) -> int:
    """Print the script of one shell."""
    print({"bash": bash, "zsh": zsh, "fish": fish}[args.shell](verbs()), end="")
    return 0


def verbs() -> list[Verb]:
    """Return every verb that is installed, with what can follow it."""
    import importlib

    from runtime import cli
    from runtime.cli.parsing import Parser

    found = []
    for name in cli.VERBS:
        if (text := cli.about(name)) is None:
            continue
        parser = Parser(prog=name)
        importlib.import_module(f"runtime.cli.{name}").add_arguments(parser)
        found.append(Verb(name, text.splitlines()[0], tuple(dict.fromkeys(_words(parser)))))
    return found


def _words(parser: argparse.ArgumentParser) -> list[str]:
    """Return options and choices of a parser and of those under it."""
    from runtime import graph

    words: list[str] = []
    for action in parser._actions:
        words += [option for option in action.option_strings if option.startswith("--")]
        if isinstance(action, argparse._SubParsersAction):
            for name, child in action.choices.items():
                words += [name, *_words(child)]
        elif action.choices is not None and not action.option_strings:
            words += [str(choice) for choice in action.choices]
        elif action.dest == "graph":
            words += graph.ours()
    return words


def bash(known: list[Verb]) -> str:
    """Return the script for bash."""
    cases = "\n".join(f"        {verb.name}) words={shlex.quote(' '.join(verb.words))} ;;" for verb in known)
    return _BASH.format(verbs=" ".join(verb.name for verb in known), cases=cases)


def zsh(known: list[Verb]) -> str:
    """Return the script for zsh, which understands that of bash when asked to."""
    return "autoload -U +X bashcompinit && bashcompinit\n" + bash(known)


def fish(known: list[Verb]) -> str:
    """Return the script for fish."""
    lines = []
    for verb in known:
        about = shlex.quote(verb.help)
        lines.append(f"complete -c hallway -n __fish_use_subcommand -f -a {verb.name} -d {about}")
        under = f"-n '__fish_seen_subcommand_from {verb.name}'"
        for word in verb.words:
            what = f"-l {word[2:]}" if word.startswith("--") else f"-a {shlex.quote(word)}"
            lines.append(f"complete -c hallway {under} {what}")
    return "\n".join(lines) + "\n"
