import os
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
CI = ROOT / ".ci" / "run"


def commands():
    """Every line of the README's shell blocks."""
    blocks = re.findall(r"```sh\n(.*?)```", README, flags=re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line.strip()]


def test_ci_runs_the_test_command_of_the_readme_word_for_word():
    tests = [line for line in commands() if line.rstrip().endswith("pytest -n 2")]
    assert len(tests) == 1
    assert f'"{tests[0]}"' in CI.read_text()


def test_the_first_two_commands_are_complete_by_themselves():
    demo, test = [line for line in commands() if "venv" in line][:2]
    for line in (demo, test):
        assert line.startswith("python3.11 -m venv .venv && .venv/bin/pip install ")
    assert demo.endswith("hallway up demo")


def test_ci_is_executable_and_parses():
    assert os.access(CI, os.X_OK)
    assert subprocess.run(["bash", "-n", CI], check=False).returncode == 0


def test_the_licence_is_apache_2_in_full():
    licence = (ROOT / "LICENSE").read_text()
    assert "Version 2.0, January 2004" in licence
    assert "END OF TERMS AND CONDITIONS" in licence
    assert 11_000 < len(licence) < 11_600
