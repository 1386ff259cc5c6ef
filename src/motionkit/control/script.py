"""Scripts: motion types one after another, each for some seconds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from motionkit.errors import ControlError
from motionkit.names import nfc

DEFAULT_SECONDS = 4.0
MAX_SECONDS = 3600.0


@dataclass(frozen=True)
class TypePart:
    """A motion type for some seconds."""

    type: str
    seconds: float


def parse_types(
    text: str, seconds: float | None = None, usual: Callable[[Sequence[str]], list[float]] | None = None
) -> list[TypePart]:
    """Parse "running,cartwheel" or "running:4,cartwheel:3" into parts.

    Args:
        seconds: total duration; parts without a time share what the others leave.
        usual: returns the usual seconds of each type of a list, 0 for none. Without seconds, a part without a time
            takes these, or DEFAULT_SECONDS.

    Raises:
        ControlError: for a part without a type, or a time that is not a positive number.
    """
    words = [nfc(word.strip()) for word in text.split(",")]
    if not any(words):
        raise ControlError("expected motion types such as running,cartwheel, found none")
    timed: list[tuple[str, float | None]] = []
    for word in words:
        name, _, time = word.partition(":")
        if not name:
            raise ControlError(f"expected type or type:seconds, found {word!r}")
        timed.append((name.strip(), _seconds(time, word) if time else None))
    free = [name for name, time in timed if time is None]
    timed_seconds = sum(time for _, time in timed if time is not None)
    if seconds is not None and free:
        share = (seconds - timed_seconds) / len(free)
        if share <= 0:
            raise ControlError(
                f"the other parts take {timed_seconds:g} of {seconds:g} s and leave none for {free[0]}"
            )
    elif seconds is not None:
        # Every part has a time: stretch all to the total.
        return [TypePart(name, time * seconds / timed_seconds) for name, time in timed if time is not None]
    else:
        names = [name for name, _ in timed]
        natural = usual(names) if usual else [0.0] * len(names)
        return [
            TypePart(name, time or default or DEFAULT_SECONDS)
            for (name, time), default in zip(timed, natural, strict=True)
        ]
    return [TypePart(name, share if time is None else time) for name, time in timed]


def _seconds(text: str, word: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ControlError(f"expected seconds after the colon, found {word!r}") from None
    if not 0 < value <= MAX_SECONDS:
        raise ControlError(f"expected more than 0 and at most {MAX_SECONDS:g} seconds, found {word!r}")
    return value
