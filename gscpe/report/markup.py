"""HTML and SVG out of small pieces; text is escaped unless it is markup already."""

from __future__ import annotations

import html

_VOID = frozenset({"br", "hr", "img", "input", "link", "meta"})


class Markup(str):
    """Text that is HTML already, and must not be escaped again."""

    __slots__ = ()


def escape(text: str) -> Markup:
    """The text as HTML, good inside elements and quoted attributes."""
    return text if isinstance(text, Markup) else Markup(html.escape(text, quote=True))


def join(*pieces: str) -> Markup:
    """Pieces one after the other; plain text among them is escaped."""
    return Markup("".join(escape(piece) for piece in pieces))


def element(name: str, /, *content: str, **attributes: str | float | bool | None) -> Markup:
    """``<name ...>content</name>``.

    Attributes are named as in HTML, with ``_`` for ``-`` and at the end of Python's words
    (``class_``); None and False leave one out, True gives it no value. Numbers are written
    with at most two decimals.
    """
    written = "".join(
        f" {key.rstrip('_').replace('_', '-')}"
        + ("" if value is True else f'="{escape(_text(value))}"')
        for key, value in attributes.items()
        if value is not None and value is not False
    )
    if name in _VOID:
        return Markup(f"<{name}{written}>")
    return Markup(f"<{name}{written}>{join(*content)}</{name}>")


def _text(value: str | float) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.2f}".rstrip("0").rstrip(".")
