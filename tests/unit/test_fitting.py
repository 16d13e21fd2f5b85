import contextlib
import io

import pytest

from runtime.cli.fitting import fitted, print_written

NAMES = [f"a-file-of-some-length-{n}.mcap" for n in range(7)] + ["x" * 90]


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    return Terminal()


def test_no_name_of_a_file_is_cut_in_two_on_a_terminal(terminal):
    with contextlib.redirect_stdout(terminal):
        print_written("results/latest", NAMES)
    folder, *lines = terminal.getvalue().splitlines()
    assert folder == "results/latest/:"
    assert [name for line in lines for name in line.strip().rstrip(",").split(", ")] == NAMES
    assert len(lines) > 2
    assert all(len(line) <= 80 for line in lines if "xxx" not in line)


def test_another_program_gets_a_line_whole(capsys):
    print_written("results/latest", NAMES)
    assert capsys.readouterr().out == f"results/latest/:\n  {', '.join(NAMES)}\n"


def test_a_column_goes_on_under_itself(terminal):
    first, second = fitted(f"{'host':<20} {'machine=x86_64, ' * 5}".rstrip(), 21, terminal).splitlines()
    assert first.startswith("host                 machine")
    assert second.startswith(" " * 21 + "machine")
