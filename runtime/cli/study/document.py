"""Headings, words, tables and figures, put on a page as Markdown or as HTML."""

import html
from collections.abc import Sequence
from dataclasses import dataclass

_STYLE = """
body { font: 15px/1.5 sans-serif; color: #1c2430; max-width: 1120px; margin: 24px auto; padding: 0 16px }
table { border-collapse: collapse; display: block; overflow-x: auto; margin: 12px 0 }
th, td { padding: 3px 9px; border-bottom: 1px solid #e2e6ea; text-align: left; vertical-align: bottom }
td { white-space: nowrap }
.number { text-align: right; font-variant-numeric: tabular-nums }
figure { margin: 18px 0 } figcaption { color: #464e58 } img { max-width: 100%; border: 1px solid #e2e6ea }
"""


@dataclass(frozen=True, slots=True)
class Heading:
    """A title: level 1 for the page, 2 for a part, 3 for a part of that."""

    words: str
    level: int = 2


@dataclass(frozen=True, slots=True)
class Words:
    """A paragraph."""

    words: str


@dataclass(frozen=True, slots=True)
class Table:
    """Titles of the columns, and rows of as many cells; numbers stand below each other on the right."""

    titles: Sequence[str]
    rows: Sequence[Sequence[str]]

    def of_numbers(self) -> list[bool]:
        """Return of each column whether it holds numbers, or nothing, alone."""
        return [all(map(_is_number, column)) for column in zip(*self.rows, strict=True)]


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture in a file beside the page, and what is to be seen in it."""

    file: str
    caption: str


Block = Heading | Words | Table | Figure


def markdown(blocks: Sequence[Block]) -> str:
    """Return the page as Markdown."""
    return "\n".join(_marked(block) for block in blocks)


def web_page(blocks: Sequence[Block]) -> str:
    """Return the page as HTML, of one file but for its pictures; its title is that of the first heading."""
    title = next(block.words for block in blocks if isinstance(block, Heading))
    body = "\n".join(_tagged(block) for block in blocks)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{_STYLE}</style></head><body>\n{body}\n</body></html>\n"
    )


def _marked(block: Block) -> str:
    match block:
        case Heading(words, level):
            return f"{'#' * level} {words}\n"
        case Words(words):
            return f"{words}\n"
        case Figure(file, caption):
            return f"![{caption}]({file})\n\n*{caption}*\n"
        case Table(titles, rows):
            lines = ["| " + " | ".join(cells) + " |" for cells in (titles, *rows)]
            rule = "".join("---:|" if numbers else "---|" for numbers in block.of_numbers())
            return "\n".join([lines[0], f"|{rule}", *lines[1:]]) + "\n"


def _tagged(block: Block) -> str:
    match block:
        case Heading(words, level):
            return f"<h{level}>{html.escape(words)}</h{level}>"
        case Words(words):
            return f"<p>{html.escape(words)}</p>"
        case Figure(file, caption):
            said = html.escape(caption)
            picture = f'<img src="{html.escape(file)}" alt="{said}" loading="lazy">'
            return f"<figure>{picture}<figcaption>{said}</figcaption></figure>"
        case Table(titles, rows):
            numbers = block.of_numbers()
            body = "".join(_row(row, "td", numbers) for row in rows)
            return f"<table>{_row(titles, 'th', numbers)}{body}</table>"


def _row(cells: Sequence[str], tag: str, numbers: Sequence[bool]) -> str:
    kinds = (' class="number"' if number else "" for number in numbers)
    each = (f"<{tag}{kind}>{html.escape(cell)}</{tag}>" for cell, kind in zip(cells, kinds, strict=True))
    return f"<tr>{''.join(each)}</tr>"


def _is_number(cell: str) -> bool:
    try:
        float(cell.removesuffix("%") or 0)
    except ValueError:
        return False
    return True
