"""What the pages say: their commands exist, their programs run, their links lead somewhere."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from runtime import cli
from runtime.cli.parsing import Parser

ROOT = Path(__file__).parents[2]
PAGES = {page.name: page for page in sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])}
CHEAP = ("--version", "completion bash", "doctor --udev", "config check", "config dump")
"""Calls that are run as they stand."""

_CALL = re.compile(r"(?:^|[\s/(])hallway((?:[ ]+[^\s|&;()\"`]+)*)", flags=re.MULTILINE)


def blocks(name, language):
    return re.findall(rf"```{language}\n(.*?)```", PAGES[name].read_text(), flags=re.DOTALL)


def prose_of(page):
    """Return a page without its blocks of code."""
    return re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)


def calls():
    """Every call of ours in a shell block of a page: (page, words)."""
    found = set()
    for name in PAGES:
        lines = [line.split("# ")[0] for line in "\n".join(blocks(name, "sh")).splitlines()]
        words = [call.split() for call in _CALL.findall("\n".join(lines))]
        found |= {(name, tuple(call)) for call in words if call}
    return sorted(found)


def spelled(value):
    return value if isinstance(value, str) else " ".join(value)


def python(*arguments):
    return subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=100, check=False
    )


def test_there_are_calls_to_look_at():
    assert len(calls()) > 10


@pytest.mark.parametrize(("page", "words"), calls(), ids=spelled)
def test_every_call_on_a_page_is_one_that_hallway_takes(page, words):
    if words == ("--version",):
        return
    verb, *rest = words
    assert verb in cli.VERBS, f"{page}: hallway {verb}"
    parser = Parser(exit_on_error=False)
    importlib.import_module(f"runtime.cli.{verb}").add_arguments(parser)
    parser.parse_args(rest)  # a wrong option raises or exits


@pytest.mark.parametrize("page", [name for name in PAGES if blocks(name, "python")])
def test_every_program_on_a_page_runs(page):
    done = python("-W", "error", "-c", "\n".join(blocks(page, "python")))
    assert done.returncode == 0, done.stderr


def test_cheap_calls_do_what_the_pages_promise():
    ran = 0
    for page, words in calls():
        missing = [word for word in words if word.endswith(".yaml") and not (ROOT / word).exists()]
        if not " ".join(words).startswith(CHEAP) or missing:
            continue
        done = python("-m", "runtime.cli", *words)
        assert done.returncode == 0, f"{page}: {words}: {done.stderr}"
        assert done.stdout.strip()
        ran += 1
    assert ran >= 3


def test_every_link_of_a_page_leads_somewhere():
    for name, page in PAGES.items():
        prose = prose_of(page)
        links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", prose) + re.findall(r'<img src="([^"]+)"', prose)
        for target in links:
            if not target.startswith(("http://", "https://")):
                assert (page.parent / target).is_file(), f"{name}: {target}"


def test_every_link_into_a_page_finds_its_heading_there():
    prose = {
        name: re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL) for name, page in PAGES.items()
    }
    looked = 0
    for name, text in prose.items():
        for target, place in re.findall(r"\]\(([^)#:]*)#([^)]*)\)", text):
            there = prose[Path(target).name if target else name]
            heads = re.findall(r"^#+ (.*)$", there, flags=re.MULTILINE)
            places = [re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads]
            assert place in places or f'<a id="{place}">' in there, f"{name}: {target}#{place}"
            looked += 1
    assert looked >= 5


def test_pictures_of_the_pages_are_small():
    for picture in (ROOT / "docs").rglob("*.png"):
        assert picture.stat().st_size < 150_000, picture


def test_the_reference_pages_are_what_the_code_says():
    done = python("docs/make_reference.py", "--check")
    assert done.returncode == 0, done.stdout + done.stderr
