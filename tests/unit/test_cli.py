"""The command line: what exists is listed, what is broken breaks nobody else, errors are one line."""

import subprocess
import sys
from pathlib import Path

import pytest

from runtime import cli
from runtime.errors import ConfigError, DataLostError, HallwayError, exit_code_of


@pytest.fixture
def verb(tmp_path, monkeypatch):
    """Write a verb module of our own into the package, for this test alone."""
    monkeypatch.setattr(cli, "VERBS", (*cli.VERBS, "trial_verb"))
    monkeypatch.setattr(cli, "__path__", [*cli.__path__, str(tmp_path)])

    def write(body, top=""):
        (tmp_path / "trial_verb.py").write_text(
            f'"""Try something."""\n{top}\n'
            'def add_arguments(parser):\n    parser.add_argument("--n", type=int)\n'
            f"def run(args):\n    {body}\n"
        )

    yield write
    sys.modules.pop("runtime.cli.trial_verb", None)


def test_help_lists_the_verbs_that_are_there(capsys, verb):
    verb("return 0")
    with pytest.raises(SystemExit) as ended:
        cli.main(["--help"])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert "trial_verb" in out
    assert "Try something." in out
    assert "exit codes: 0 good" in out


@pytest.mark.parametrize("name", [name for name in cli.VERBS if name != "completion"])
def test_every_verb_has_one_line_in_the_help_of_a_narrow_terminal(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        cli.main(["--help"])
    lines = capsys.readouterr().out.splitlines()
    first = cli.about(name).splitlines()[0]
    assert any(line.split(maxsplit=1) == [name, first] for line in lines)


def test_a_verb_that_cannot_be_imported_breaks_no_other(capsys, verb):
    verb("return 0", top="import a_library_that_is_not_there")
    with pytest.raises(SystemExit) as ended:
        cli.main(["up", "--help"])
    assert ended.value.code == 0


def test_a_verb_gets_its_arguments_and_gives_the_exit_code(verb):
    verb("return args.n")
    assert cli.main(["trial_verb", "--n", "4"]) == 4


@pytest.mark.parametrize(
    ("body", "code", "text"),
    [
        (
            "from runtime.errors import ConfigError; raise ConfigError('a.b = 3, must be 4')",
            2,
            "a.b = 3, must be 4",
        ),
        ("from runtime.errors import DataLostError; raise DataLostError('3 scans')", 4, "3 scans"),
        ("from drivers.errors import DeviceError; raise DeviceError('no laser')", 3, "no laser"),
        ("open('/no/such/file')", 2, "/no/such/file: No such file or directory"),
        ("raise PermissionError(13, 'Permission denied', 'a.clf')", 2, "a.clf: Permission denied"),
        ("raise OSError(5, 'Input/output error', '/dev/ttyACM0')", 1, "ttyACM0: Input/output error"),
    ],
)
def test_an_expected_error_is_one_line_and_its_exit_code(verb, capsys, body, code, text):
    verb(body)
    assert cli.main(["trial_verb"]) == code
    err = capsys.readouterr().err
    assert err.startswith("hallway trial_verb: ")
    assert text in err
    assert err.count("\n") == 1


def test_a_bug_keeps_its_traceback(verb):
    verb("raise KeyError('a bug')")
    with pytest.raises(KeyError, match="a bug"):
        cli.main(["trial_verb"])


def test_ctrl_c_is_130(verb):
    verb("raise KeyboardInterrupt")
    assert cli.main(["trial_verb"]) == 130


def test_an_unknown_verb_is_a_usage_error(capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["upp"])
    assert ended.value.code == 2
    assert "'upp'" in capsys.readouterr().err


def test_an_unknown_option_is_said_under_the_usage_of_its_verb(verb, capsys):
    verb("return 0")
    with pytest.raises(SystemExit) as ended:
        cli.main(["trial_verb", "--n", "4", "--m", "5"])
    assert ended.value.code == 2
    err = capsys.readouterr().err
    assert err.startswith("usage: hallway trial_verb [-h] [--n N]")
    assert "unrecognized arguments: --m 5" in err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            "up demo --headles",
            "hallway up: error: unrecognized arguments: --headles; did you mean '--headless'?",
        ),
        ("up demo --head", "unrecognized arguments: --head; did you mean '--headless'?"),
        ("--headless up demo", "unrecognized arguments: --headless; write it at the end of the line"),
        ("topic echo scan --ful=1", "unrecognized arguments: --ful=1; did you mean '--full'?"),
        (
            "topic ech scan",
            "hallway topic: error: argument ACTION: invalid choice: 'ech'; did you mean 'echo'?",
        ),
        ("mapp a.log", "hallway: error: argument VERB: invalid choice: 'mapp'; did you mean 'map'?"),
        ("keys invite me --role king", "invalid choice: 'king'; choose from viewer, operator, machine"),
        ("replay a.mcap --start nan", "argument --start: nan, must be at least 0 and finite"),
        ("evaluate a.tum --reference b.tum --laser-in-base inf 0 0", "inf, must be finite"),
        ("topic --domain 233 list", "argument --domain: 233, must be in [0, 232]"),
        ("keys invite a --address h:99999", "h:99999, must be HOST or HOST:PORT, the port in [1, 65535]"),
        ("up demo --remote 1.2.3.4:x", "argument --remote: 1.2.3.4:x, must be HOST or HOST:PORT"),
        ("view --connect :7448", "argument --connect: :7448, must be HOST or HOST:PORT"),
        ("logs -n -5", "argument -n/--lines: -5, must be at least 0"),
        ("doctor --seconds x", "argument --seconds: 'x', must be a number"),
        ("map a.log b.log", "unrecognized arguments: b.log\n"),
        ("config", "are required: ACTION; `hallway config --help` lists what it may be"),
        ("up", "are required: graph; `hallway up --help` lists what it may be"),
    ],
)
def test_a_word_is_taken_whole_or_refused_with_the_nearest_one(words, said, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(words.split())
    assert ended.value.code == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        "topic list --robot lab",
        "topic --robot lab list",
        "topic --domain 7 --robot lab hz scan",
        "topic --domain 7 hz scan --robot lab",
        "keys list --robot lab",
        "keys --robot lab list",
        "status --robot lab",
    ],
)
def test_the_robot_is_named_before_an_action_or_behind_it(words, monkeypatch):
    told = []
    name = words.split()[0]
    monkeypatch.setattr(f"runtime.cli.{name}.run", lambda args: told.append(vars(args)) or 0)
    assert cli.main(words.split()) == 0
    assert told[0]["robot"] == "lab"
    assert told[0].get("domain", 0) == 7 * ("7" in words)


def test_no_verb_at_all_is_a_usage_error_that_shows_the_verbs(capsys):
    assert cli.main([]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "Start a robot" in err


def test_help_needs_nothing_heavy():
    program = (
        "import sys\nfrom runtime.cli import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'zenoh', 'rerun', 'rosbags', 'yaml', 'rich'} & set(sys.modules)\n"
        "sys.exit(f'imported: {heavy}' if heavy else 0)"
    )
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=root, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("name", cli.VERBS)
def test_the_help_of_every_verb_needs_nothing_heavy(name):
    root = Path(__file__).resolve().parents[2]
    if not (root / "runtime" / "cli" / f"{name}.py").exists():
        pytest.skip(f"needs runtime/cli/{name}.py")
    program = (
        "import sys\nfrom runtime.cli import main\n"
        f"try: main([{name!r}, '--help'])\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'zenoh', 'rerun', 'rosbags', 'yaml', 'serial'} & set(sys.modules)\n"
        "sys.exit(f'imported: {heavy}' if heavy else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=root, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_errors_know_their_exit_codes():
    assert [exit_code_of(e) for e in (HallwayError("x"), ConfigError("x"), DataLostError("x"))] == [1, 2, 4]
    assert exit_code_of(ValueError("x")) is None
