from runtime.cli.written import print_written


def test_no_name_of_a_file_is_cut_in_two(capsys):
    names = [f"a-file-of-some-length-{n}.mcap" for n in range(7)] + ["x" * 90]
    print_written("results/latest", names)
    folder, *lines = capsys.readouterr().out.splitlines()
    assert folder == "results/latest/:"
    assert [name for line in lines for name in line.strip().rstrip(",").split(", ")] == names
    assert len(lines) > 2
    assert all(len(line) <= 80 for line in lines if "xxx" not in line)
