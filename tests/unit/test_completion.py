import argparse
import shutil
import subprocess

import pytest

from runtime import cli
from runtime.cli import completion, main


@pytest.fixture(scope="module")
def known():
    return completion.verbs()


def installed(shell):
    if shutil.which(shell) is None:
        pytest.skip(f"needs {shell}")


def complete(script, *words):
    """What bash offers after these words, the last of them unfinished."""
    line = " ".join(f"'{word}'" for word in words)
    ask = f"COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _hallway; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    done = subprocess.run(
        ["bash", "--norc", "-c", f"{script}\n{ask}"], capture_output=True, text=True, check=True
    )
    return done.stdout.split()


def test_every_installed_verb_is_offered(known):
    there = [verb for verb in cli.VERBS if cli.about(verb) is not None]
    offered = complete(completion.bash(known), "hallway", "")
    assert set(there) <= set(offered)
    assert {"up", "map", "view", "completion"} <= set(offered)


def test_bash_offers_verbs_options_and_files(known, tmp_path, monkeypatch):
    script = completion.bash(known)
    (tmp_path / "exp1.dat").touch()
    monkeypatch.chdir(tmp_path)
    assert complete(script, "hallway", "vi") == ["view"]
    assert "--seed" in complete(script, "hallway", "map", "--s")
    assert complete(script, "hallway", "map", "ex") == ["exp1.dat"]
    assert {"bash", "zsh", "fish"} <= set(complete(script, "hallway", "completion", ""))


def test_the_graphs_that_we_bring_are_offered(known):
    script = completion.bash(known)
    for words in (("up", ""), ("config", "dump", "")):
        assert {"demo", "handheld", "onboard"} <= set(complete(script, "hallway", *words))


@pytest.mark.parametrize("shell", completion.SHELLS)
def test_each_shell_takes_its_script(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "evaluate" in script
    installed(shell)
    assert subprocess.run([shell, "-n"], input=script, text=True, check=False).returncode == 0


def test_options_of_verbs_under_verbs_are_found():
    parser = argparse.ArgumentParser()
    inner = parser.add_subparsers().add_parser("dump")
    inner.add_argument("--only", choices=("a", "b"))
    parser.add_argument("kind", choices=("x", "y"))
    assert completion._words(parser) == ["--help", "dump", "--help", "--only", "x", "y"]
