"""Sentences of Markdown pages, to count their words.

python docs/prose.py [PAGE ...]      counts a page, and all sentences that are too long
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

HERE = Path(__file__).parent
#: A sentence of more words is long.
LONG = 35


def sentences(text: str) -> list[str]:
    """Return the sentences of a page: of paragraphs and lists, not of tables, titles and code."""
    text = re.sub(r"^ *(`{3,}).*?^ *\1 *$", "<code>", text, flags=re.S | re.M)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.S)
    found: list[str] = []
    paragraph: list[str] = []
    in_list = False
    for line in [*text.split("\n"), ""]:
        words = line.strip()
        item = re.match(r"(?:[*-]|\d+\.)\s+(.*)", words)
        aside = re.match(r"#|\||<|!\[|:::|:\w", words)
        # four blanks are code, but for what belongs to an item of a list
        code = line.startswith("    ") and not in_list and not paragraph
        if not words or item or aside or code:
            found += _split(" ".join(paragraph))
            paragraph = []
            if words and not item and not line.startswith(" "):
                in_list = False
        if item:
            in_list = True
            paragraph.append(item[1])
        elif words and not aside and not code:
            if not line.startswith(" ") and not paragraph:
                in_list = False
            paragraph.append(words)
    return found


def _split(paragraph: str) -> list[str]:
    paragraph = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", paragraph)  # links are their words
    paragraph = re.sub(r"`[^`]*`", "code", paragraph)  # code is a word
    paragraph = re.sub(r"(\$+)[^$]+\1", "formula", paragraph)  # and a formula one
    paragraph = re.sub(r"\b(e\.g|i\.e|etc|cf|Fig|vs)\.", r"\1", paragraph)
    return [s for s in re.split(r"(?<=[.!?])[*_)\"”]*\s+", paragraph) if count(s)]


def count(sentence: str) -> int:
    """Return the number of words: what has a letter or a digit."""
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def main() -> None:
    """Run the command."""
    pages = [Path(name) for name in sys.argv[1:]] or sorted(HERE.rglob("*.md"))
    for page in pages:
        found = sentences(page.read_text(encoding="utf-8"))
        lengths = [count(s) for s in found]
        too_long = [s for s in found if count(s) > LONG]
        mean = sum(lengths) / max(len(lengths), 1)
        print(f"{page}: {len(found)} sentences of {mean:.1f} words, {len(too_long)} above {LONG}")
        for sentence in too_long:
            print(f"    {count(sentence)}: {sentence}")


if __name__ == "__main__":
    main()
