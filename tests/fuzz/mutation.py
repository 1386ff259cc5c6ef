"""Shared means of the fuzz tests: mutated bytes, text and JSON, and a run that may only end in one clear line.

Everything random comes from a random.Random that hypothesis draws the seed of, so that a failing case is
small to tell and comes again.
"""

from __future__ import annotations

import gc
import json
import os
import random
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any

from motionkit.errors import MotionkitError
from motionkit.names import visible

# Every long test takes its share of this time; those of models and their runs take a half.
SLOW_SECONDS = float(os.environ.get("MOTIONKIT_FUZZ_SECONDS", "1200"))
SLOW_SEED = int(os.environ.get("MOTIONKIT_FUZZ_SEED", "1000000"))  # of the first case of each
CASE_SECONDS = 20
READING_SECONDS = 1.0  # of the processor, for a file of some kB
CASE_BYTES = 2**30

NUMBERS = (
    *("0", "-1", "1", "2", "1e39", "-1e39", "1e308", "-1e308", "1e400", "nan", "inf", "-inf", "1e-45", "1e6"),
    *("1e7", "1e9", "9" * 401, "4294967296", "-2147483649", "9223372036854775808", "0x10", "1_0", "1,5"),
    *("-0", ".", "", "1e", "true", "٣"),
)
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2, 1e39, -1e39, 1e308, 10**15, 2**63, -(2**31), 1e-45, float("nan")),
    *(float("inf"), 10**400, "", "x", "a" * 1000, "\0", "../x", "a,b", "a:b", "[/b]", "\ud800", [], {}),
    *([[]], [None], {"": None}, [0] * 1000, "walking", [1e39]),
)
SCRAPS = (
    *(
        b"\0",
        b"\xff",
        b"\x1c",
        b"\r",
        b"\n",
        b" ",
        b"\t",
        b"{",
        b"}",
        b"[",
        b"]",
        b'"',
        b",",
        b":",
        b"-",
        b"e",
    ),
    *(b"\xc2\xa0", "\u2028".encode(), b"\xef\xbb\xbf", b"\xff\xfe", b"[" * 3000, b"1" * 5000, b"a" * 5000),
)


def mutated_bytes(chance: random.Random, data: bytes, scraps: Iterable[bytes] = ()) -> bytes:
    """The bytes after one to three changes: cut off, cut out, doubled, overwritten, or with scraps put in."""
    out, pieces = bytearray(data), (*SCRAPS, *scraps)
    for _ in range(chance.randint(1, 3)):
        at = chance.randrange(len(out) + 1)
        length = min(chance.choice((0, 1, 2, 8, 100)), len(out) - at)
        change = chance.randrange(6)
        if change == 0:
            del out[at:]
        elif change == 1:
            del out[at : at + length]
        elif change == 2:
            out[at:at] = out[at : at + 10 * length] * chance.randint(1, 3)
        elif change == 3 and at < len(out):
            out[at] ^= 1 << chance.randrange(8)
        elif change == 4:
            out[at : at + length] = chance.randbytes(length)
        else:
            out[at : at + length] = chance.choice(pieces)
    return bytes(out)


def mutated_text(chance: random.Random, text: str, words: Iterable[str] = ()) -> bytes:
    """A text after one to three changes of whole words or lines, or of its bytes, as UTF-8."""
    pieces = (*NUMBERS, *words)
    for _ in range(chance.randint(1, 3)):
        lines = text.split("\n")
        line = chance.randrange(len(lines))
        change = chance.randrange(6)
        if change <= 2:  # a word: the likeliest to pass the grammar
            parts = _words(lines[line])
            if parts:
                at = chance.randrange(len(parts))
                parts[at] = chance.choice(pieces)
                lines[line] = "".join(parts)
        elif change == 3:
            del lines[line]
        elif change == 4:
            lines.insert(chance.randrange(len(lines)), lines[line])
        else:
            return mutated_bytes(chance, "\n".join(lines).encode())
        text = "\n".join(lines)
    return text.encode("utf-8", "surrogatepass")


def _words(line: str) -> list[str]:
    """The line cut between words and what separates them."""
    out: list[str] = []
    for c in line:
        if out and (c in ' \t,:;[]{}"') == (out[-1][-1] in ' \t,:;[]{}"'):
            out[-1] += c
        else:
            out.append(c)
    return out


def mutated_json(chance: random.Random, value: Any) -> Any:
    """A copy of a JSON value after one to three changes: of a value, a key, or the length of a list."""
    value = json.loads(json.dumps(value))
    for _ in range(chance.randint(1, 3)):
        places = [(None, None), *_places(value)]
        holder, key = chance.choice(places[1:] or places)
        if chance.random() < 0.6:  # few values are lists of numbers far down
            near = [place for place in places if _depth(place, places) <= 2]
            holder, key = chance.choice(near)
        value = _changed(chance, value, holder, key)
    return value


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Every (holder, key) in a JSON value; of long lists only the first few."""
    found, waiting = [], [value]
    while waiting:
        holder = waiting.pop()
        keys: Iterable[Any] = ()
        if isinstance(holder, dict):
            keys = list(holder)
        elif isinstance(holder, list):
            keys = range(min(len(holder), 5))
        for key in keys:
            found.append((holder, key))
            waiting.append(holder[key])
    return found


def _depth(place: tuple[Any, Any], places: list[tuple[Any, Any]]) -> int:
    depth, holder = 0, place[0]
    while holder is not None and depth < 9:
        above = next((h for h, k in places[1:] if h[k] is holder), None)
        depth, holder = depth + 1, above
    return depth


def _changed(chance: random.Random, value: Any, holder: Any, key: Any) -> Any:
    new = deepcopy(chance.choice(VALUES))  # a later change may be inside it
    if holder is None:
        return new if chance.random() < 0.2 else value
    change = chance.randrange(5)
    if change == 0:
        del holder[key]
    elif change == 1 and isinstance(holder[key], list):
        holder[key] = holder[key] * 2 if chance.random() < 0.5 else holder[key][: len(holder[key]) // 2]
    elif change == 2 and isinstance(holder[key], (int, float)) and not isinstance(holder[key], bool):
        holder[key] = chance.choice((-1, 1)) * (holder[key] + 1) * 10 ** chance.randrange(0, 40, 3)
    elif change == 3 and isinstance(holder, dict):
        holder[str(new)[:20]] = holder.pop(key)
    else:
        holder[key] = new
    return value


# ---- running one case ----


def refuses_or_works(work: Callable[[], object], seconds: float = CASE_SECONDS) -> str:
    """Run work; its one-line refusal, or "" if it worked. Any other exception goes on as a failure.

    Args:
        work: what may take CASE_BYTES of memory above what is in use.
        seconds: of the processor that it may take.
    """
    message, began = "", time.process_time()
    try:
        with _memory_bounded():
            work()
    except MotionkitError as error:
        message = str(error)
        assert message and message == visible(message) and "Traceback" not in message, repr(message)
        assert len(message) < 2000, message[:3000]
    assert time.process_time() - began < seconds, message
    return message


@contextmanager
def _memory_bounded() -> Iterator[None]:
    """Let allocations of more than CASE_BYTES raise MemoryError during a block."""
    import resource  # not on Windows

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + CASE_BYTES
    if soft == resource.RLIM_INFINITY or limit < soft:
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def refuses_or_works_apart(work: Callable[[], object]) -> None:
    """refuses_or_works in a forked child, which is ended after CASE_SECONDS.

    Raises AssertionError with the child's traceback, or the signal that ended it.
    """
    reading, writing = os.pipe()
    gc.collect()
    child = os.fork()
    if child == 0:
        os.close(reading)
        code = 1
        try:
            _limit_child()
            refuses_or_works(work)
            code = 0
        except BaseException:
            os.write(writing, traceback.format_exc()[-4000:].encode("utf-8", "replace"))
        finally:
            sys.stdout.flush()
            os._exit(code)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        told = pipe.read().decode("utf-8", "replace")
    _, status = os.waitpid(child, 0)
    assert not os.WIFSIGNALED(status), f"ended by signal {signal.Signals(os.WTERMSIG(status)).name}"
    assert os.WEXITSTATUS(status) == 0, told


def _limit_child() -> None:
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(CASE_SECONDS)
    # The parent's OpenMP threads do not live in a fork: work that is shared among them would wait for ever.
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


def files_below(folder: Path) -> set[str]:
    """Every name below a folder, to see that a refusal leaves none behind."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def for_seconds(seconds: float, case: Callable[[random.Random], object]) -> None:
    """Run a case with one seed after the other until the time is up, at least one, and print how many.

    A failure names its seed.
    """
    end, seed = time.monotonic() + seconds, SLOW_SEED
    while seed == SLOW_SEED or time.monotonic() < end:
        try:
            case(random.Random(seed))
        except BaseException as error:
            error.add_note(f"seed {seed}") if hasattr(error, "add_note") else None
            raise
        seed += 1
    print(f"{seed - SLOW_SEED} tried")
