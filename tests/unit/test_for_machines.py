import json

from runtime.cli.for_machines import print_json


def test_what_is_no_number_is_null_in_one_line(capsys):
    print_json({"rmse": float("nan"), "way": [1.0, float("inf")], "name": "Flur"})
    out = capsys.readouterr().out
    assert out.count("\n") == 1

    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    assert json.loads(out, parse_constant=refuse) == {"rmse": None, "way": [1.0, None], "name": "Flur"}
