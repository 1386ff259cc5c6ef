"""Safe file access: reads only regular files of limited size, writes atomically, never overwrites an input.

Also lists the files below a folder, parses JSON within limits, and makes file names valid on every system.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import stat
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Any, BinaryIO

from motionkit.errors import MotionkitError, OverwriteError
from motionkit.interrupts import uninterrupted
from motionkit.locks import lock, names_file, remove_abandoned

MAX_TEXT_BYTES = 64 * 2**20  # bytes, about 67 MB; limit of a label table, a path or a JSON file
MAX_JSON_DEPTH = 50  # nested lists and objects; deeper ones could exhaust the stack of Python
MAX_JSON_NODES = 2_000_000  # lists and objects; each takes about a hundred bytes of memory
MAX_JSON_DIGITS = 40  # digits of an integer; saved states of random generators have 39
MARKED_BYTES = 4096  # of a file, which say whether motionkit wrote it
SLOTS = 8  # runs that may write one output at a time
_SLOTS = tuple(f".motionkit-{number}" for number in range(SLOTS))  # endings of their temporary files


@contextmanager
def atomic_write(path: str | Path, mode: str = "w") -> Iterator[IO]:
    """Open a temporary file for writing and rename it to path when the block ends without an error.

    Creates missing parent folders. Removes what a killed run of the same output has left.

    Raises:
        MotionkitError: path cannot be written (it is a folder, the disk is full); path is unchanged then.
    """
    with _pending(path, mode) as pending:
        yield pending.file
        pending.finish()
        pending.put_in_place()


def write_together(contents: Mapping[Path, bytes]) -> None:
    """Write files that belong together: all are on the disk before the first takes its name, in the order given.

    Raises:
        MotionkitError: a file cannot be written; if one of them cannot be made, all are unchanged.
    """
    with ExitStack() as stack:
        every = []
        for path, data in contents.items():
            pending = stack.enter_context(_pending(path, "wb"))
            pending.file.write(data)
            pending.finish()
            every.append(pending)
        new = [pending for pending in every if not pending.target.exists()]
        with uninterrupted():
            try:
                for pending in every:
                    pending.put_in_place()
            except OSError:
                for pending in new:
                    if not pending.temporary:  # it is in place
                        pending.target.unlink()
                raise


class _Pending:
    """A temporary file beside its target, locked while its process lives, so that the next run knows leftovers."""

    def __init__(self, target: Path, mode: str) -> None:
        self.target = target
        handle, self.temporary = _open_temporary(target)
        self._guard = os.dup(
            handle
        )  # keeps the lock when the file is closed, which Windows needs to rename it
        text = {} if "b" in mode else {"encoding": "utf-8", "newline": "\n"}  # same bytes on every system
        self.file: IO = os.fdopen(handle, mode, **text)  # type: ignore[call-overload]

    def finish(self) -> None:
        """Bring the file to the disk and close it."""
        self.file.flush()
        os.fsync(self.file.fileno())
        self.file.close()
        os.chmod(self.temporary, _mode(self.target))

    def put_in_place(self) -> None:
        """Give the file its name."""
        if os.name == "nt":
            self._release()
        with uninterrupted():
            os.replace(self.temporary, self.target)
            self.temporary = ""

    def drop(self) -> None:
        """Close the file, and remove it unless it is in place."""
        with suppress(OSError):  # a full disk, which has been reported
            self.file.close()
        if self.temporary:
            Path(self.temporary).unlink(missing_ok=True)
        self._release()

    def _release(self) -> None:
        if self._guard >= 0:
            os.close(self._guard)
        self._guard = -1


@contextmanager
def _pending(path: str | Path, mode: str) -> Iterator[_Pending]:
    path = Path(path)
    _check_place(path)
    pending = None
    try:
        target = Path(os.path.realpath(path))  # follow a link instead of replacing it
        target.parent.mkdir(parents=True, exist_ok=True)
        with uninterrupted():
            pending = _Pending(target, mode)
        yield pending
    except OSError as error:
        raise MotionkitError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        if pending is not None:
            pending.drop()


def _open_temporary(target: Path) -> tuple[int, str]:
    """Make and lock a new file beside target; those that killed runs have left are removed."""
    slots = _slots(target)
    for slot in slots:
        remove_abandoned(slot)
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    for slot in slots:
        try:
            handle = os.open(slot, flags, 0o600)
        except FileExistsError:
            continue
        if os.name == "nt" or (lock(handle) is not False and names_file(slot, handle)):
            return handle, slot
        os.close(handle)  # another run took it for a leftover before it was locked
    raise OSError(f"{SLOTS} other runs are writing it, or were killed: {slots[0]} and others")


def remove_leftovers(folder: Path) -> None:
    """Remove the temporary files below a folder whose writers were killed."""
    for path in files_below(folder, _SLOTS):
        remove_abandoned(str(path))


def _slots(target: Path) -> list[str]:
    """The names of an output's temporary files."""
    name = safe_name(target.name, 200)
    return [f"{target.parent}{os.sep}.{name}{slot}" for slot in _SLOTS]


def _mode(path: Path) -> int:
    """The permissions of a file that is replaced, or those of a new one."""
    if path.is_file():
        return stat.S_IMODE(path.stat().st_mode)
    umask = os.umask(0)
    os.umask(umask)
    return 0o666 & ~umask


def _check_place(path: Path) -> None:
    if path.is_dir():
        raise MotionkitError(f"{path}: is a folder, expected a file to write")
    if path.is_file() and not os.access(path, os.W_OK):  # a rename would ignore the file's permissions
        raise MotionkitError(f"{path}: is write-protected; choose another output")
    if path.exists() and not path.is_file():  # a rename would replace a device with a file
        raise MotionkitError(f"{path}: is not a regular file, expected a file to write")
    above = next(folder for folder in path.absolute().parents if os.path.lexists(folder))
    if not above.is_dir():
        raise MotionkitError(f"{path}: cannot be written ({above} is not a folder)")


def check_outputs(outputs: Iterable[str | Path], inputs: Iterable[str | Path | None]) -> None:
    """Check, before any work, that the outputs can be written and overwrite no input.

    Args:
        outputs: files to write; a file listed twice would be written twice.
        inputs: files to read; None entries are ignored.

    Raises:
        OverwriteError: an output is also an input, or is listed twice.
        MotionkitError: an output cannot be a file.
    """
    read = {_identity(Path(path)) for path in inputs if path is not None}
    written = set()
    for path in map(Path, outputs):
        _check_place(path)
        identity = _identity(path)
        if identity in read:
            raise OverwriteError(f"{path}: is read by this command; choose another output")
        if identity in written:
            raise OverwriteError(f"{path}: would be written twice; choose another output")
        written.add(identity)


def check_foreign(paths: Iterable[Path]) -> None:
    """Check that motionkit wrote the files, which may be missing, that would be replaced or removed.

    Raises:
        OverwriteError: the first bytes of a file do not name motionkit.
    """
    for path in paths:
        if path.exists() and not _names_us(path):
            raise OverwriteError(
                f"{path}: was not written by motionkit; choose another folder, or replace it with --force"
            )


def _names_us(path: Path) -> bool:
    if not path.is_file():
        return False
    with open_regular(path, sys.maxsize) as file:
        return b"motionkit" in file.read(MARKED_BYTES)


def _identity(path: Path) -> object:
    """A key that is equal for two paths to the same file, even if it does not exist yet."""
    try:
        status = path.stat()
        return status.st_dev, status.st_ino
    except OSError:
        return os.path.realpath(path)


# ---- folders ----


def files_below(folder: str | Path, ending: str | tuple[str, ...]) -> list[Path]:
    """All files below a folder whose names end in `ending`, or one of them (in any case), sorted.

    Links to folders are followed. A folder that can be reached in several ways is listed once: by its real path if that
    is below the folder, else by the first link.

    Raises:
        MotionkitError: a folder cannot be listed.
    """

    if not Path(folder).is_dir():
        return []

    def refuse(error: OSError) -> None:
        raise MotionkitError(f"{error.filename}: cannot be listed ({error.strerror})") from None

    found: list[Path] = []
    seen: set[str] = set()
    links = [str(folder)]
    while links:
        for place, folders, names in os.walk(links.pop(0), onerror=refuse):
            real = os.path.realpath(place)
            if real in seen:
                folders.clear()
                continue
            seen.add(real)
            links += sorted(os.path.join(place, name) for name in folders if _is_link(place, name))
            found += [Path(place, name) for name in names if name.lower().endswith(ending)]
    return sorted(found)


def _is_link(place: str, name: str) -> bool:
    return os.path.islink(os.path.join(place, name))


# ---- reading ----


@contextmanager
def open_regular(
    path: str | Path, limit: int, what: str = "a file", error: type[MotionkitError] = MotionkitError
) -> Iterator[BinaryIO]:
    """Open a regular file of at most limit bytes for reading.

    Pipes and devices are refused, because reading them might never end. Links to files are followed.

    Args:
        path: file to open.
        limit: maximum size in bytes.
        what: kind of file for the message, such as "a BVH file".
        error: exception class to raise; its message names the path.
    """
    # Without O_NONBLOCK, opening a pipe waits for a writer.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        if os.path.isdir(path):
            raise error(f"{path}: is a folder, expected {what}")
        if not stat.S_ISREG(os.stat(path).st_mode):  # check before opening, which may start a device
            raise error(f"{path}: is not a regular file, expected {what}")
        file = os.fdopen(os.open(path, flags), "rb")
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except (OSError, ValueError) as fault:
        raise error(f"{path}: cannot be read ({getattr(fault, 'strerror', None) or fault})") from None
    with file:
        facts = os.fstat(file.fileno())
        if not stat.S_ISREG(facts.st_mode):  # replaced since the check above
            raise error(f"{path}: is not a regular file, expected {what}")
        if facts.st_size > limit:
            raise error(f"{path}: has {_size(facts.st_size)}, expected {what} of at most {_size(limit)}")
        yield file


def check_regular(
    path: str | Path, limit: int, what: str = "a file", error: type[MotionkitError] = MotionkitError
) -> int:
    """Size in bytes of a file that another library will open by name; raises like open_regular."""
    with open_regular(path, limit, what, error) as file:
        return os.fstat(file.fileno()).st_size


def read_bytes(
    path: str | Path, limit: int, what: str = "a file", error: type[MotionkitError] = MotionkitError
) -> bytes:
    """All bytes of a regular file; raises like open_regular."""
    with open_regular(path, limit, what, error) as file:
        size = os.fstat(file.fileno()).st_size
        try:
            data = file.read(size + 1)  # takes memory for as many bytes as are asked for
        except OSError as fault:
            raise error(f"{path}: cannot be read ({fault.strerror or fault})") from None
    if len(data) > size:
        raise error(f"{path}: another program writes it, expected {what} that is whole")
    return data


def read_text(
    path: str | Path,
    what: str = "a text file",
    error: type[MotionkitError] = MotionkitError,
    limit: int = MAX_TEXT_BYTES,
) -> str:
    """The text of a regular UTF-8 file, without a byte order mark; raises like open_regular."""
    data = read_bytes(path, limit, what, error)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        line = data.count(b"\n", 0, fault.start) + 1
        raise error(f"{path}:{line}: is not UTF-8 text, expected {what}") from None


def _size(count: int) -> str:
    for unit, factor in (("GB", 2**30), ("MB", 2**20), ("kB", 2**10)):
        if count >= factor:
            return f"{count / factor:.4g} {unit}"
    return f"{count} bytes"


# ---- JSON ----

# Matches brackets. Also matches whole strings, so that brackets inside them are skipped.
_JSON_BRACKETS = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"?|[\[{\]}]', re.DOTALL)


def read_json(
    path: str | Path, what: str = "a JSON file", error: type[MotionkitError] = MotionkitError
) -> Any:
    """The value in a JSON file; raises like read_text and parse_json, with the file's name in the message."""
    return parse_json(read_text(path, what, error), path, error)


def is_number(value: object, low: float, high: float, whole: bool = False) -> bool:
    """Whether a JSON value is a number from low to high; with whole=True, an integer."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return low <= value <= high and (isinstance(value, int) or not whole)


def parse_json(text: str, where: str | Path, error: type[MotionkitError] = MotionkitError) -> Any:
    """The value of a JSON text; depth is limited and numbers must be finite.

    Raises `error`, which says where it is from.
    """
    _check_json_depth(text, where, error)
    try:
        return json.loads(text, parse_int=_whole, parse_float=_finite, parse_constant=_finite)
    except (ValueError, RecursionError) as fault:
        raise error(f"{where}: not JSON ({fault})") from None


def check_fields(
    entry: Mapping[str, Any], known: Sequence[str], where: str | Path, error: type[MotionkitError]
) -> None:
    """Raise `error`, which says where it is from, for a field of a JSON object that is not known."""
    unknown = sorted(set(entry) - set(known))
    if unknown:
        raise error(f"{where}: unknown field {unknown[0][:40]!r}, expected {', '.join(known)}")


def _check_json_depth(text: str, where: str | Path, error: type[MotionkitError]) -> None:
    if text.count("[") + text.count("{") > MAX_JSON_NODES:
        raise error(f"{where}: JSON with more than {MAX_JSON_NODES} lists and objects")
    depth = 0
    for found in _JSON_BRACKETS.finditer(text):
        mark = found[0]
        depth += 1 if mark in "[{" else -1 if mark in "]}" else 0
        if depth > MAX_JSON_DEPTH:
            raise error(f"{where}: JSON nested more than {MAX_JSON_DEPTH} levels deep")


def _whole(word: str) -> int:
    if len(word.lstrip("-")) > MAX_JSON_DIGITS:
        raise ValueError(f"an integer of {len(word.lstrip('-'))} digits")
    return int(word)


def _finite(word: str) -> float:
    number = float(word)
    if number - number != 0.0:
        raise ValueError(f"{word[:20]} is not a finite number")
    return number


# ---- names ----

_UNSAFE = re.compile(r'[<>:"/\\|?*\x00-\x1f\x7f-\x9f\ud800-\udfff]')
_DEVICES = re.compile(r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³]|conin\$|conout\$)", re.IGNORECASE)


def safe_name(name: str, longest: int = 80) -> str:
    """A file name that is valid on every file system, made from the name of a motion type or a joint.

    Valid names are returned unchanged. Otherwise invalid characters become underscores, and a short hash of the name is
    appended, so that different names stay different.

    Args:
        name: any text.
        longest: maximum length in bytes, at least 10.
    """
    safe = _UNSAFE.sub("_", name).strip(". ") or "_"
    if _DEVICES.fullmatch(
        safe.split(".")[0].strip()
    ):  # Windows opens the device instead of a file, whatever the ending
        safe = f"_{safe}"
    fits = len(safe.encode()) <= longest
    if safe == name and fits:
        return name
    mark = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:6]
    return f"{safe.encode()[: longest - 7].decode('utf-8', 'ignore')}-{mark}"


def plain(value: Any) -> Any:
    """A value for JSON: NaN and infinity become None, tuples become lists, paths become text."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def write_json(path: Path, facts: dict[str, Any]) -> None:
    """Write plain values as a JSON file, atomically."""
    with atomic_write(path, "w") as out:
        out.write(json.dumps(facts, indent=1) + "\n")
