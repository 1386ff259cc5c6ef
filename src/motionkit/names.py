"""Text of users on a terminal, which obeys some of it."""

from __future__ import annotations

import re

# What a terminal obeys instead of showing it: control characters, changes of the direction of writing, line and
# paragraph separators; and the halves of characters that stand for bytes which are no text.
_UNSEEN = re.compile(r"[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def visible(text: object) -> str:
    r"""The text in one line that any terminal shows and none obeys: escape characters become \x1b, line ends \n."""
    return _UNSEEN.sub(_escaped, str(text))


def _escaped(found: re.Match[str]) -> str:
    code = ord(found[0])
    if 0xDC80 <= code <= 0xDCFF:  # a byte of a file name that is not UTF-8
        return f"\\x{code - 0xDC00:02x}"
    return found[0].encode("unicode_escape").decode("ascii")
