"""A table, and how it is written as text, Markdown, LaTeX and JSON."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any, Mapping, Sequence

NOTHING = "\N{EN DASH}"
"""What a cell says where there is no number."""

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
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    records: tuple[Mapping[str, Any], ...] = ()

    def __post_init__(self) -> None:
        if any(len(row) != len(self.header) for row in self.rows):
            raise ValueError(f"{self.title}: a row has another number of cells than the header")


def to_text(tables: Sequence[Table]) -> str:
    """Aligned columns, the first one to the left."""
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
            cell.rjust(width) if i else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    ]
    lines.insert(1, "  ".join("-" * width for width in widths))
    return "\n".join([table.title, "", *lines, *([""] if table.notes else []), *table.notes])


def _markdown(table: Table) -> str:
    lines = [f"### {table.title.translate(_MARKDOWN)}", ""]
    for row in (table.header, None, *table.rows):
        if row is None:
            lines.append("|---|" + "---:|" * (len(table.header) - 1))
        else:
            lines.append("| " + " | ".join(cell.translate(_MARKDOWN) for cell in row) + " |")
    for note in table.notes:
        lines += ["", note.translate(_MARKDOWN)]
    return "\n".join(lines)


def _latex(table: Table) -> str:
    def line(row: Sequence[str]) -> str:
        return "    " + " & ".join(cell.translate(_LATEX) for cell in row) + r" \\"

    notes = [rf"  \\ {{\footnotesize {note.translate(_LATEX)}}}" for note in table.notes]
    return "\n".join(
        [
            r"\begin{table}",
            r"  \centering",
            rf"  \caption{{{table.title.translate(_LATEX)}}}",
            rf"  \begin{{tabular}}{{l{'r' * (len(table.header) - 1)}}}",
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
