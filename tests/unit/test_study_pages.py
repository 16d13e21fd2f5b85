"""What `hallway paper` puts on its pages, from numbers that are made up here."""

from html.parser import HTMLParser

import numpy as np
import pytest

from runtime.cli.study import stages, tables
from runtime.cli.study.curves import plot, ticks
from runtime.cli.study.document import Figure, Heading, Table, Words, markdown, web_page

SCANS = 100


def numbers(match_mm, degenerate):
    """What a study of one building returns, alike for all variants."""
    columns = ("ahead_mm", "aside_mm", "match_deg", "stretch_mm", "ate_m", "max_m", "lost", "ms")
    row = dict.fromkeys(columns, 0.0) | {"match_mm": match_mm, "degenerate": degenerate, "scans": SCANS}
    return {variant: dict(row) for variant in stages.variants()}


def worth(buildings):
    """The sentence over the table of stages, and the first row of the table and of that of hurried drives."""
    page = tables.page(buildings, buildings, {})
    at = next(n for n, block in enumerate(page) if block == Heading("What each stage is worth"))
    return page[at + 1].words, page[at + 2].rows[0], page[at + 4].rows[0]


def test_the_means_leave_out_the_blind_buildings_and_name_the_others():
    buildings = {"corridor": numbers(90.0, 99), "hallway": numbers(1.0, 5), "floor": numbers(3.0, 0)}
    sentence, row, hurried = worth(buildings)
    assert sentence.startswith("Means over hallway and floor, where")
    assert "corridor" not in sentence.split(";")[0]
    assert row[1] == hurried[1] == "2.0"


def test_one_blind_scan_strikes_no_building_off_and_a_larger_share_does():
    most = round(tables.BLIND_SHARE * SCANS)
    assert tables.seen_buildings({"a": numbers(1.0, 1)}) == ["a"]
    assert tables.seen_buildings({"a": numbers(1.0, most), "b": numbers(1.0, most + 1)}) == ["a"]


def test_the_hurried_drives_are_compared_over_the_same_buildings():
    calm = {"hall": numbers(1.0, 0), "floor": numbers(3.0, 0)}
    hurried = {"hall": numbers(10.0, 50), "floor": numbers(30.0, 0)}
    page = tables.page(calm, hurried, {})
    at = next(n for n, block in enumerate(page) if block == Heading("What the rows are"))
    assert page[at - 1].rows[0][1] == "20.0"


def test_every_row_and_column_is_explained_on_the_page():
    calm = {"hall": numbers(1.0, 0)}
    log = dict.fromkeys(("scans", "entropy", "conflict", "lost", "degenerate", "ms"), 0.0)
    page = tables.page(calm, calm, {"exp1": dict.fromkeys(stages.of_a_log(), log)})
    keys = [block for block in page if isinstance(block, Table) and len(block.titles) == 2]
    explained = {name for key in keys for name, about in key.rows if about}
    shown = {table.titles[0]: table for table in page if isinstance(table, Table) and table not in keys}
    for first in ("building", "pipeline"):
        assert set(shown[first].titles[1:]) <= explained
    assert set(stages.variants()) <= explained


def test_where_every_building_is_blind_the_page_says_so():
    sentence, row, _ = worth({"corridor": numbers(90.0, 99), "loop": numbers(10.0, 60)})
    assert sentence.startswith("Means over corridor and loop;")
    assert "compare little" in sentence
    assert row[1] == "50.0"


def test_every_figure_is_explained_on_the_page():
    blocks = tables.figures(["pillar hall"])
    kinds = [block.words for block in blocks if isinstance(block, Heading)][1:]
    pictures = [block for block in blocks if isinstance(block, Figure)]
    assert len(pictures) == len(kinds) == sum(isinstance(block, Words) for block in blocks) == 7
    assert all(picture.file.endswith("-pillar-hall.png") for picture in pictures)
    explained = [block.words for block in blocks if isinstance(block, Words)]
    assert "thirty times as far" in explained[-1]
    assert "in common" in explained[-1]


class Seen(HTMLParser):
    """What a browser would find: open tags, words, pictures."""

    def __init__(self):
        super().__init__()
        self.open, self.words, self.pictures = [], [], []

    def handle_starttag(self, tag, attrs):
        if tag == "img":
            self.pictures.append(dict(attrs))
        elif tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


PAGE = (
    Heading("All & sundry", 1),
    Words("1 < 2"),
    Table(("a", "b"), [("x", "<y>")]),
    Figure("f.png", 'seen "so"'),
)


def test_the_web_page_holds_what_the_blocks_say():
    seen = Seen()
    seen.feed(web_page(PAGE))
    assert seen.open == []
    assert {"All & sundry", "1 < 2", "a", "b", "x", "<y>", 'seen "so"'} <= set(seen.words)
    assert [(p["src"], p["alt"]) for p in seen.pictures] == [("f.png", 'seen "so"')]


def test_the_same_blocks_are_markdown():
    lines = markdown(PAGE).splitlines()
    assert lines[0] == "# All & sundry"
    assert lines[lines.index("| a | b |") + 1 :][:2] == ["|---|---|", "| x | <y> |"]
    assert '![seen "so"](f.png)' in lines


def test_what_nobody_measured_is_an_empty_cell():
    short = numbers(1.0, 0)
    short[stages.WHOLE]["stretch_mm"] = float("nan")
    page = tables.page({"hall": short}, {"hall": short}, {})
    whole = next(block for block in page if isinstance(block, Table) and block.titles[0] == "building")
    assert whole.rows[0][whole.titles.index("over 1 m, mm")] == ""


def test_words_stand_on_the_left_and_numbers_on_the_right():
    table = Table(("what", "how", "1 m, mm"), [("a", "0.5", ""), ("b", "30 at most", "1.25%")])
    assert markdown([table]).splitlines()[1] == "|---|---|---:|"
    page = web_page([Heading("A", 1), table])
    assert page.count('class="number"') == 3
    assert '<th class="number">1 m, mm</th>' in page
    assert '<td>30 at most</td><td class="number">1.25%</td>' in page


@pytest.mark.parametrize(
    ("most", "step", "count"), [(0.95, 0.2, 5), (0.82, 0.2, 5), (50, 10, 6), (30, 10, 4), (7, 2, 4)]
)
def test_ticks_are_round_and_few(most, step, count):
    assert ticks(most) == pytest.approx([n * step for n in range(count)])


def test_a_tick_has_its_line_at_its_height():
    size = 400
    image = np.asarray(plot({"a": np.array([0.0, 10.0])}, "t", size)).astype(int)
    rows = np.flatnonzero((image[:, 60:200].max(axis=-1) < 250).mean(axis=1) > 0.8)
    # From 40 px over the bottom to 34 px under the top: 0 to 10.5, ticks at 2, 4, 6, 8 and 10.
    high = size - 40 - (size - 74) * np.array([2, 4, 6, 8, 10]) / 10.5
    assert all(np.abs(rows - row).min() <= 1 for row in high)
    assert len(rows) <= 2 * (len(high) + 1)  # and none but these and the axis
