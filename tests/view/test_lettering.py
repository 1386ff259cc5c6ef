from __future__ import annotations

import unicodedata
from collections.abc import Iterator
from typing import Any

import pytest
from PIL import ImageFont

from motionkit.view import lettering
from motionkit.view.contact_sheet import contact_sheet
from motionkit.view.lettering import lettered
from synthetic_motions import make_walk

LATIN = "Hüpfen links, Drücken, čtyři, łódź, été, ÆØÅ ß ñ, tiến, Ωμέγα, прыжок"


@pytest.fixture(autouse=True)
def bare_system(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A machine without fonts of its own."""
    monkeypatch.setattr(lettering, "SYSTEM_FONTS", ())
    lettered.cache_clear()
    yield
    lettered.cache_clear()


def lacking(words: str, font: Any) -> list[str]:
    """Letters that are drawn as a box."""
    box = bytes(font.getmask("\U0010ffff"))
    return [letter for letter in words if letter != " " and bytes(font.getmask(letter)) == box]


@pytest.mark.parametrize("words", LATIN.split(", "))
def test_letters_with_marks_are_drawn(words: str) -> None:
    drawn, font = lettered(words, 20)
    assert drawn == words and not lacking(drawn, font)
    assert lettered(unicodedata.normalize("NFD", words), 20)[0] == words


def test_plain_words_keep_their_font() -> None:
    if not isinstance(lettering._default_font(20), ImageFont.FreeTypeFont):
        pytest.skip("this Pillow has no font of its own for any size")
    assert lettered("walking 3", 20)[1].getname() != lettered("zurück", 20)[1].getname()


@pytest.mark.parametrize(
    ("words", "drawn"),
    [
        ("走り", "U+8D70 U+308A"),
        ("kick左", "kick U+5DE6"),
        ("x\u0302y", "xy"),
        ("कि", "U+0915 U+093F"),
        ("ｋｉｃｋ", "kick"),
        ("a\nb", "a?b"),
    ],
)
def test_other_scripts_are_spelled_out(words: str, drawn: str) -> None:
    found, font = lettered(words, 20)
    assert found == drawn and not lacking(found, font)


def test_a_font_of_the_system_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    font = lettering._named_font(lettering.BUNDLED_FONT, 20)
    monkeypatch.setattr(lettering, "SYSTEM_FONTS", ("has-them.ttc",))
    if not lettering._lacking(lettering._default_font(20), "été"):
        pytest.skip("this Pillow's own font has the letters")
    monkeypatch.setattr(lettering, "_named_font", lambda name, size: font if name == "has-them.ttc" else None)
    assert lettered("été", 20) == ("été", font)


def test_a_pillow_without_freetype(monkeypatch: pytest.MonkeyPatch) -> None:
    bitmap = getattr(ImageFont, "load_default_imagefont", ImageFont.load_default)()
    monkeypatch.setattr(lettering, "_default_font", lambda size: bitmap)
    monkeypatch.setattr(lettering, "_named_font", lambda name, size: None)
    assert [lettered(words, 20)[0] for words in ("été", "čas", "走")] == ["été", "cas", "U+8D70"]


def test_sheets_differ_by_a_mark() -> None:
    plain, marked = (contact_sheet([(title, make_walk(30))]).tobytes() for title in ("Hupfen", "Hüpfen"))
    assert plain != marked
    apart = contact_sheet([(unicodedata.normalize("NFD", "Hüpfen"), make_walk(30))]).tobytes()
    assert apart == marked
