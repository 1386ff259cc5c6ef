"""Words for left and right, in names of joints and of motion types."""

from __future__ import annotations

# Left and right words of the languages that rigs and folders are named in; single letters of English only.
WORDS: tuple[tuple[str, str], ...] = (
    ("left", "right"),
    ("l", "r"),
    ("links", "rechts"),
    ("linke", "rechte"),
    ("linker", "rechter"),
    ("linkes", "rechtes"),
    ("linken", "rechten"),
    ("gauche", "droite"),
    ("gauche", "droit"),
    ("izquierda", "derecha"),
    ("izquierdo", "derecho"),
    ("sinistra", "destra"),
    ("sinistro", "destro"),
    ("esquerda", "direita"),
    ("esquerdo", "direito"),
    ("левая", "правая"),
    ("левый", "правый"),
    ("левое", "правое"),
    ("левой", "правой"),
    ("左", "右"),
    ("왼쪽", "오른쪽"),
    ("왼", "오른"),
    ("hidari", "migi"),
)
LEFT_WORDS = frozenset(left for left, _ in WORDS)
# A word that stands for two on the other side ("gauche") is not among them: the first pair counts.
OTHER = {left: right for left, right in reversed(WORDS)} | {right: left for left, right in WORDS}
LONG_WORDS = tuple(
    sorted((word for word in OTHER if len(word) > 3 or not word.isascii()), key=len, reverse=True)
)


def other_side(word: str) -> str:
    """The word for the other side, in the same case; a word that names no side as it is."""
    other = OTHER.get(word.lower())
    if other is None:
        return word
    if word.isupper():
        return other.upper()
    return other.capitalize() if word[:1].isupper() else other
