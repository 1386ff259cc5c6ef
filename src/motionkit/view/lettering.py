"""Chooses a font that has all letters of a text, so that none is drawn as a box.

Pillow's own font has little more than ASCII. Other text is drawn with the Latin, Greek and Cyrillic letters of
assets/fonts, else with a font of the system. Letters that no font has are spelled out.
"""

from __future__ import annotations

import io
import unicodedata
from collections.abc import Iterator
from functools import lru_cache
from importlib.resources import files
from typing import Any

from motionkit.names import nfc

BUNDLED_FONT = "DejaVuSans-letters.ttf"
# Fonts for other scripts; Pillow finds these names in the font folders of Windows, macOS and Linux.
SYSTEM_FONTS = (
    "NotoSansCJK-Regular.ttc",
    "NotoSansCJKjp-Regular.otf",
    "DroidSansFallbackFull.ttf",
    "wqy-microhei.ttc",
    "wqy-zenhei.ttc",
    "fonts-japanese-gothic.ttf",
    "Arial Unicode.ttf",
    "Hiragino Sans GB.ttc",
    "AppleSDGothicNeo.ttc",
    "YuGothM.ttc",
    "msgothic.ttc",
    "msyh.ttc",
    "malgun.ttf",
    "seguisym.ttf",
    "DejaVuSans.ttf",
    "FreeSans.ttf",
)
_MARKS = frozenset(map(chr, range(0x300, 0x370)))  # combining marks; dropped where NFC keeps them
_NO_LETTER = "\U0010ffff"  # no font has this letter, so it is drawn as the font's missing-letter box


@lru_cache(maxsize=1024)
def lettered(words: str, size: float) -> tuple[str, Any]:
    """A text as one line to draw, and a font of a size in pixels.

    Letters that no font has lose their marks, or become their code, such as U+65E5.
    """
    words = "".join(letter if letter.isprintable() else "?" for letter in nfc(words))
    found: list[tuple[int, Any]] = []
    for font in _fonts(size):
        lacking = len(_lacking(font, words))
        if not lacking:
            return words, font
        found.append((lacking, font))
    _, best = min(found, key=lambda each: each[0])
    return _spelled(words, best), best


def _fonts(size: float) -> Iterator[Any]:
    """Candidate fonts: Pillow's own if it is scalable (from Pillow 10.1, with FreeType), then others."""
    from PIL import ImageFont

    default = _default_font(size)
    scalable = [
        font
        for font in (default, _named_font(BUNDLED_FONT, size))
        if isinstance(font, ImageFont.FreeTypeFont)
    ]
    if not scalable:
        yield default
        return
    yield from scalable
    yield from filter(None, (_named_font(name, size) for name in SYSTEM_FONTS))


@lru_cache(maxsize=64)
def _default_font(size: float) -> Any:
    from PIL import ImageFont

    try:
        return ImageFont.load_default(size)
    except TypeError:  # Pillow 10.0
        return ImageFont.load_default()


@lru_cache(maxsize=512)
def _named_font(name: str, size: float) -> Any:
    """A font by its file name; None if it is missing or Pillow has no FreeType."""
    from PIL import ImageFont

    data = (files("motionkit") / "assets" / "fonts" / name).read_bytes() if name == BUNDLED_FONT else None
    try:
        return ImageFont.truetype(name if data is None else io.BytesIO(data), round(size))
    except (OSError, ImportError):
        return None


def _lacking(font: Any, words: str) -> set[str]:
    """The letters of a text that a font lacks."""
    letters = {letter for letter in words if not letter.isspace()}
    from PIL import ImageFont

    if not isinstance(font, ImageFont.FreeTypeFont):
        return {letter for letter in letters if ord(letter) > 255}
    single = font.font_variant(layout_engine=ImageFont.Layout.BASIC)  # no dotted circle under marks
    box = _drawn(single, _NO_LETTER)
    return {letter for letter in letters if letter in _MARKS or _drawn(single, letter) == box}


def _drawn(font: Any, letter: str) -> tuple[Any, bytes]:
    mask = font.getmask(letter)
    return mask.size, bytes(mask)


def _spelled(words: str, font: Any) -> str:
    lacking, out = _lacking(font, words), ""
    for letter in words:
        plain = "".join(c for c in unicodedata.normalize("NFKD", letter) if not unicodedata.combining(c))
        if letter not in lacking:
            out += letter
        elif _lacking(font, plain):
            out += f" U+{ord(letter):04X} "
        else:
            out += plain
    return " ".join(out.split()) or "?"
