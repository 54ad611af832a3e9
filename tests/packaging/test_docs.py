# SPDX-License-Identifier: Apache-2.0
"""The documents hang together: a merge can leave a section twice, a rename a link to nowhere."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WRITTEN = Path("docs/api.md")  # by a program, from docstrings that may be alike
DOCUMENTS = sorted(path.relative_to(ROOT) for path in [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
each_document = pytest.mark.parametrize("document", DOCUMENTS, ids=str)

LINK = re.compile(r"\]\(([^)\s]+)\)")
FILE = re.compile(r"`((?:gscpe|tools|tests|examples|docs)/[\w/.-]*\w)`")


def prose(document: Path) -> str:
    """Without blocks of code."""
    text = (ROOT / document).read_text("utf-8")
    return re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)


def headings(document: Path) -> list[str]:
    return re.findall(r"^#+ +(.+)$", prose(document), re.MULTILINE)


def anchors(document: Path) -> set[str]:
    """As GitHub makes them."""
    found: Counter[str] = Counter()
    names = set()
    for heading in headings(document):
        text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").replace("*", "")
        name = re.sub(r"[^\w\- ]", "", text.lower()).strip().replace(" ", "-")
        names.add(f"{name}-{found[name]}" if found[name] else name)
        found[name] += 1
    return names


def test_there_are_documents() -> None:
    assert {Path("README.md"), Path("CHANGELOG.md"), WRITTEN} <= set(DOCUMENTS)
    assert "photos-in" in anchors(Path("docs/formats.md"))


@each_document
def test_links_lead_somewhere(document: Path) -> None:
    for link in LINK.findall(prose(document)):
        if re.match(r"\w+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (ROOT / document).parent / path if path else ROOT / document
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target.resolve().relative_to(ROOT)), link


@each_document
def test_files_that_are_named_exist(document: Path) -> None:
    for name in FILE.findall(prose(document)):
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize("document", [d for d in DOCUMENTS if d != WRITTEN], ids=str)
def test_nothing_stands_twice(document: Path) -> None:
    text = prose(document)
    assert not re.search(r"^(<<<<<<<|>>>>>>>|=======$)", text, re.MULTILINE)
    parts = [" ".join(part.split()) for part in re.split(r"\n\s*\n|\n(?=- )", text)]
    twice = Counter(part for part in parts if len(part) > 60) + Counter(headings(document))
    assert not [part for part, count in twice.items() if count > 1]
