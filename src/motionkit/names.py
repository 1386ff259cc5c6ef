"""Text for users: Unicode normal form, safe terminal output, plurals, durations."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence

# Characters that control a terminal: control characters, changes of text direction, line and paragraph separators. Also
# lone surrogates, which stand for undecodable bytes.
_UNSEEN = re.compile(r"[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def visible(text: object) -> str:
    r"""The text as one printable line: control characters are escaped, a line end as \n."""
    return _UNSEEN.sub(_escaped, str(text))


def _escaped(found: re.Match[str]) -> str:
    code = ord(found[0])
    if 0xDC80 <= code <= 0xDCFF:  # a byte of a file name that is not UTF-8
        return f"\\x{code - 0xDC00:02x}"
    return found[0].encode("unicode_escape").decode("ascii")


def joint_names(names: Iterable[str], longest: int) -> tuple[str, ...]:
    """Unique names of joints for every format: at most `longest` letters, no spaces, braces or control characters."""
    out: dict[str, int] = {}  # each name and the next number for another joint of that name
    for name in names:
        name = re.sub(rf"[\s{{}}]+|{_UNSEEN.pattern}", "_", nfc(name).strip())[: longest - 8] or "_"
        free = name
        while free in out:
            out[name] += 1
            free = f"{name}_{out[name]}"
        out[free] = 1
    return tuple(out)


def nfc(name: str) -> str:
    """The name in Unicode's composed form (NFC), in which names are stored and looked up.

    macOS decomposes folder names: its "ü" can be "u" with a combining mark, which looks the same.
    """
    return unicodedata.normalize("NFC", name)


def counted(number: int, word: str) -> str:
    """A number with its noun: "1 run", "2 runs"."""
    return f"{number} {word}{'' if number == 1 else 's'}"


def first_lines(lines: Sequence[str], most: int, what: str, whole: str = "--json lists all") -> list[str]:
    """The first lines of a list, how many more there are, such as "files", and what lists the whole."""
    rest = len(lines) - most
    return [*lines[:most], *([f"... and {rest} more {what}; {whole}"] if rest > 0 else [])]


def duration(seconds: float) -> str:
    """A duration in words: "40 s", "4 min", "2.5 h"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def about(name: str, text: str) -> str:
    """A message about a file, prefixed with the file's name unless it contains it."""
    return text if name in text else f"{name}: {text}"


# What people call motion types besides their names: beginnings of words, and the types that they may mean.
MEANT = {
    "idle": ("look", "stand", "wait", "breath", "rest", "listen", "talk", "stay"),
    "walking": ("stroll", "stride", "step", "march", "strut"),
    "running": ("jog", "sprint", "race", "rush", "dash"),
    "jumping-b": ("jump", "hop", "leap", "bounc"),
    "punching": ("box", "hit", "punch", "jab"),
    "martial-arts": ("fight", "karate", "kungfu", "combat", "wushu"),
    "dance-modern": ("danc",),
    "dive-roll": ("roll", "tumbl"),
    "backflip": ("flip", "somersault", "salto", "acrobat"),
    "duck": ("crouch", "sneak", "bow", "bend"),
    "twist": ("spin", "pirouette"),
}


def unknown_name(what: str, name: str, known: tuple[str, ...]) -> str:
    """The message for an unknown name, with the known one that is meant (MEANT) or spelt most alike."""
    import difflib

    word = name.lower()
    near = [kind for kind, begins in MEANT.items() if kind in known and word.startswith(begins)]
    near = near or difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"unknown {what} {name!r}{hint} (known: {', '.join(known)})"


def listed(text: str) -> list[str]:
    """The names in a text, between commas."""
    return [name.strip() for name in text.split(",")]
