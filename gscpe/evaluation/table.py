# SPDX-License-Identifier: Apache-2.0
"""A table, and how it is written as text, Markdown, LaTeX and JSON; the report's template writes
it as HTML."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from typing import Any, Mapping, Sequence

from gscpe.evaluation.text import NOTHING

_MARKDOWN = str.maketrans({c: f"\\{c}" for c in "\\`*_[]<>|"} | {"\n": " "})
_LATEX = str.maketrans(
    {c: f"\\{c}" for c in "&%$#_{}"}
    | {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
        "°": r"$^\circ$",
        NOTHING: "--",
        "\n": " ",
    }
)


@dataclass(frozen=True)
class Table:
    """A table for people, and the numbers in it.

    Attributes:
        title: plain text.
        header: a text a column.
        rows: of as many texts; the first is what the row is about.
        notes: footnotes, plain text.
        records: what the JSON file holds: an object a row, with units in the keys. Numbers
            that are not finite become null.
        words: headings of columns, beside the first, that hold words: they begin at the left.
        keys: what each row is about, as drawings and style sheets name it, for example "coarse";
            empty, or as many as rows.
        tips: what a heading means, by heading, plain text.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    records: tuple[Mapping[str, Any], ...] = ()
    words: tuple[str, ...] = ()
    keys: tuple[str, ...] = ()
    tips: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.keys and len(self.keys) != len(self.rows):
            raise ValueError(f"{self.title}: {len(self.keys)} keys for {len(self.rows)} rows")
        unknown = {*self.words, *self.tips} - {*self.header}
        if unknown:
            raise ValueError(f"{self.title}: no column is named {min(unknown)!r}")
        if any(len(row) != len(self.header) for row in self.rows):
            raise ValueError(f"{self.title}: a row has another number of cells than the header")

    @property
    def are_words(self) -> tuple[bool, ...]:
        """A column each: whether it holds words, which begin at the left, or numbers."""
        return tuple(not i or name in self.words for i, name in enumerate(self.header))


def to_text(tables: Sequence[Table]) -> str:
    """Aligned columns, words to the left and numbers to the right."""
    return "\n\n".join(map(_text, tables)) + "\n"


def to_markdown(tables: Sequence[Table]) -> str:
    """A heading of level 3 and a pipe table each."""
    return "\n\n".join(map(_markdown, tables)) + "\n"


def to_latex(tables: Sequence[Table]) -> str:
    """A ``table`` environment each, for a document that has ``\\usepackage{booktabs}``."""
    head = "% \\usepackage{booktabs}, and for UTF-8 names a LaTeX of 2018 or newer\n"
    return head + "\n\n".join(map(_latex, tables)) + "\n"


def to_json(tables: Sequence[Table]) -> str:
    """All numbers as they are, not rounded; strict JSON, without NaN."""
    data = {
        "tables": [
            {"title": table.title, "notes": list(table.notes), "rows": _plain(table.records)}
            for table in tables
        ]
    }
    return json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _text(table: Table) -> str:
    cells = [table.header, *table.rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = [
        "  ".join(
            cell.ljust(width) if words else cell.rjust(width)
            for cell, width, words in zip(row, widths, table.are_words, strict=True)
        ).rstrip()
        for row in cells
    ]
    lines.insert(1, "  ".join("-" * width for width in widths))
    return "\n".join([table.title, "", *lines, *([""] if table.notes else []), *table.notes])


def _markdown(table: Table) -> str:
    lines = [f"### {table.title.translate(_MARKDOWN)}", ""]
    for row in (table.header, None, *table.rows):
        if row is None:
            lines.append("|" + "".join("---|" if words else "---:|" for words in table.are_words))
        else:
            lines.append("| " + " | ".join(cell.translate(_MARKDOWN) for cell in row) + " |")
    for note in table.notes:
        lines += ["", note.translate(_MARKDOWN)]
    return "\n".join(lines)


def _latex(table: Table) -> str:
    def line(row: Sequence[str]) -> str:
        return "    " + " & ".join(cell.translate(_LATEX) for cell in row) + r" \\"

    columns = "".join("l" if words else "r" for words in table.are_words)
    notes = [rf"  \\ {{\footnotesize {note.translate(_LATEX)}}}" for note in table.notes]
    return "\n".join(
        [
            r"\begin{table}",
            r"  \centering",
            rf"  \caption{{{table.title.translate(_LATEX)}}}",
            rf"  \begin{{tabular}}{{{columns}}}",
            r"    \toprule",
            line(table.header),
            r"    \midrule",
            *map(line, table.rows),
            r"    \bottomrule",
            r"  \end{tabular}",
            *notes,
            r"\end{table}",
        ]
    )


def _plain(value: Any) -> Any:
    """The value with numbers that JSON has no words for as null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
