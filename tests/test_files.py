"""Safe file access: regular files of limited size, bounded JSON, valid names, atomic writes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import FrameType

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motionkit import files
from motionkit.errors import DatasetError, MotionkitError, OverwriteError
from motionkit.files import (
    MARKED_BYTES,
    MAX_JSON_DEPTH,
    SLOTS,
    atomic_write,
    check_foreign,
    check_outputs,
    check_regular,
    files_below,
    is_number,
    parse_json,
    read_bytes,
    read_json,
    read_text,
    safe_name,
    write_together,
)
from motionkit.interrupts import postpone
from motionkit.locks import locked, remove_abandoned

ONE_MB = 2**20


def refusal(path: Path, limit: int = ONE_MB) -> str:
    with pytest.raises(DatasetError) as caught:
        read_bytes(path, limit, "a dataset", DatasetError)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and "\n" not in message
    with pytest.raises(DatasetError) as checked:
        check_regular(path, limit, "a dataset", DatasetError)
    assert str(checked.value) == message
    return message


def test_a_regular_file_is_read(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    (tmp_path / "link").symlink_to(tmp_path / "a")
    assert read_bytes(tmp_path / "a", 3) == read_bytes(tmp_path / "link", 3) == b"abc"
    assert check_regular(tmp_path / "a", 3) == 3


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert "is not a regular file, expected a dataset" in refusal(tmp_path / "pipe")


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no device of zeros here")
def test_a_link_to_a_device_is_refused(tmp_path: Path) -> None:
    (tmp_path / "zeros").symlink_to("/dev/zero")
    assert "is not a regular file" in refusal(tmp_path / "zeros")


def test_a_file_over_the_limit_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(2 * 2**30)
    assert "has 2 GB, expected a dataset of at most 1 MB" in refusal(tmp_path / "sparse")


@pytest.mark.parametrize(
    ("limit", "says"),
    [
        (0, "0 bytes"), (1023, "1023 bytes"), (1024, "1 kB"), (1536, "1.5 kB"), (2**20 - 1024, "1023 kB"),
        (2**20, "1 MB"), (2**30 - 2**20, "1023 MB"), (2**30, "1 GB"), (5 * 2**29, "2.5 GB"),
    ],
)  # fmt: skip
def test_sizes_are_told_in_units_that_people_read(tmp_path: Path, limit: int, says: str) -> None:
    with (tmp_path / "a").open("wb") as file:
        file.truncate(limit)
    assert check_regular(tmp_path / "a", limit) == limit, "as large as may be"
    with (tmp_path / "a").open("ab") as file:
        file.truncate(limit + 1)
    assert refusal(tmp_path / "a", limit).endswith(f"expected a dataset of at most {says}")


def test_folder_missing_file_and_impossible_name(tmp_path: Path) -> None:
    assert "is a folder, expected a dataset" in refusal(tmp_path)
    assert "no such file" in refusal(tmp_path / "nowhere")
    assert "cannot be read" in refusal(tmp_path / ("x" * 300))
    with pytest.raises(MotionkitError, match="null"):
        read_bytes(f"{tmp_path}/a\0b", 10)


def test_text_that_is_not_utf8_is_told_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "t").write_bytes(b"one\ntwo \xff\n")
    with pytest.raises(MotionkitError, match=r"t:2: is not UTF-8"):
        read_text(tmp_path / "t")
    (tmp_path / "t").write_bytes(b"\xef\xbb\xbfone")
    assert read_text(tmp_path / "t") == "one"


def test_a_small_file_takes_little_memory_whatever_the_limit(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    tracemalloc.start()
    try:
        assert read_bytes(tmp_path / "a", 2**28) == b"abc"
        assert tracemalloc.get_traced_memory()[1] < ONE_MB
    finally:
        tracemalloc.stop()


def test_a_file_that_grows_while_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, honest = tmp_path / "a", os.fstat
    path.write_bytes(b"abc")

    def fstat(handle: int) -> os.stat_result:
        facts = honest(handle)
        with path.open("ab") as file:
            file.write(b"d")
        return facts

    monkeypatch.setattr(os, "fstat", fstat)
    with pytest.raises(DatasetError, match="a: another program writes it, expected a dataset that is whole"):
        read_bytes(path, ONE_MB, "a dataset", DatasetError)


# ---- JSON ----


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[" * 100_000, "nested more than"),
        ('{"a":' * 100_000 + "1", "nested more than"),
        ("[" + "[],{}," * 1_000_000 + "[]]", "more than 2000000 lists"),
        ("9" * 401, "401 digits"),
        ("-" + "9" * 41, "41 digits"),
        ("[1e400]", "1e400 is not a finite number"),
        (f"[{'9' * 30}e999]", f"({'9' * 20} is not a finite number"),
        ("[NaN]", "NaN is not a finite number"),
        ("[-Infinity]", "-Infinity is not a finite number"),
        ('"\\', "not JSON"),
        ("", "not JSON"),
    ],
)
def test_json_that_is_refused(text: str, says: str) -> None:
    with pytest.raises(DatasetError) as caught:
        parse_json(text, "file.json", DatasetError)
    message = str(caught.value)
    assert message.startswith("file.json: ") and says in message and "\n" not in message


def test_json_as_deep_as_may_be_and_brackets_in_strings(tmp_path: Path) -> None:
    text = "[" * MAX_JSON_DEPTH + json.dumps('[{"\\' * 100) + "]" * MAX_JSON_DEPTH
    (tmp_path / "a.json").write_text(text)
    assert read_json(tmp_path / "a.json") == json.loads(text)


def test_one_level_too_many_is_refused() -> None:
    parse_json("[" * MAX_JSON_DEPTH + "]" * MAX_JSON_DEPTH, "a")
    assert parse_json("-" + "9" * 40, "a") == 1 - 10**40, "as long as may be"
    with pytest.raises(MotionkitError, match=f"more than {MAX_JSON_DEPTH} levels"):
        parse_json("[" * (MAX_JSON_DEPTH + 1) + "]" * (MAX_JSON_DEPTH + 1), "a")


@pytest.mark.parametrize(
    ("value", "whole", "is_one"),
    [
        (1, False, True), (2.5, False, True), (3, False, True), (0.99, False, False), (3.01, False, False),
        (2, True, True), (2.0, True, False), (True, False, False), ("2", False, False), (None, False, False),
    ],
)  # fmt: skip
def test_what_a_number_is(value: object, whole: bool, is_one: bool) -> None:
    assert is_number(value, 1, 3, whole) == is_one


@pytest.mark.parametrize(("objects", "refused"), [(2, False), (3, True)])
def test_lists_and_objects_are_counted_together(
    monkeypatch: pytest.MonkeyPatch, objects: int, refused: bool
) -> None:
    monkeypatch.setattr(files, "MAX_JSON_NODES", 5)
    text = "[[[" + ",".join(["{}"] * objects) + "]]]"
    if refused:
        with pytest.raises(MotionkitError, match="more than 5 lists and objects"):
            parse_json(text, "it")
    else:
        assert parse_json(text, "it") == [[[{}, {}]]]


def test_quotes_without_end_take_no_time() -> None:
    with pytest.raises(MotionkitError):
        parse_json('"' + '\\"' * 1_000_000, "file.json")


# ---- names ----

FORBIDDEN = set('<>:"/\\|?*')
DEVICES = {"con", "prn", "aux", "nul", *(f"{n}{i}" for n in ("com", "lpt") for i in range(10))}


@pytest.mark.parametrize("name", ["walking", "jumping-l", "walk fast", "Ärger", "a.b"])
def test_a_good_name_stays(name: str) -> None:
    assert safe_name(name) == name


@pytest.mark.parametrize(
    "name",
    [
        *("walk/run", "..", ".", "", "aux", "NUL.txt", "com1", "a:b", "walk.", " x", "a\nb", "x" * 300),
        *("\udcff", "C:\\x", "ä" * 100, ".hidden", "con .bvh"),
    ],
)
def test_a_bad_name_becomes_one_that_all_systems_hold(name: str, tmp_path: Path) -> None:
    safe = safe_name(name)
    check_safe(safe)
    (tmp_path / f"{safe}.bvh").write_text("x")
    assert [p.name for p in tmp_path.iterdir()] == [f"{safe}.bvh"]


def check_safe(safe: str) -> None:
    assert safe and len(safe.encode()) <= 80 and not FORBIDDEN & set(safe)
    assert safe == safe.strip(" .") and safe.split(".")[0].strip().lower() not in DEVICES
    assert all(ord(c) >= 32 for c in safe)


@settings(derandomize=True, max_examples=200, deadline=None)
@given(st.lists(st.text(alphabet="ab/:.\\ \0ä", max_size=100), unique=True))
def test_different_names_stay_different(names: list[str]) -> None:
    safe = [safe_name(name) for name in names]
    assert len(set(safe)) == len(names)
    for name in safe:
        check_safe(name)


# ---- writing ----


def test_a_file_that_is_replaced_keeps_its_permissions(tmp_path: Path) -> None:
    path = tmp_path / "mine.bvh"
    path.touch()
    path.chmod(0o600)
    with atomic_write(path) as file:
        file.write("x")
    assert path.stat().st_mode & 0o777 == 0o600
    path.chmod(0o444)
    if os.access(path, os.W_OK):
        pytest.skip("this user may write to protected files")
    with pytest.raises(MotionkitError, match="is write-protected"), atomic_write(path):
        pass
    with pytest.raises(MotionkitError, match="is write-protected"):
        check_outputs([path], [])


def test_lines_end_alike_on_all_systems(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Text is written with plain newlines, even where the system's line end differs."""
    seen = []
    honest = os.fdopen

    def fdopen(handle: int, mode: str, **options: str) -> object:
        seen.append(options.get("newline"))
        return honest(handle, mode, **options)  # type: ignore[call-overload]

    monkeypatch.setattr(os, "fdopen", fdopen)
    with atomic_write(tmp_path / "text") as file:
        file.write("a\n")
    assert seen == ["\n"] and (tmp_path / "text").read_bytes() == b"a\n"


def test_a_new_file_has_the_usual_permissions(tmp_path: Path) -> None:
    before = os.umask(0o020)
    try:
        with atomic_write(tmp_path / "new"):
            pass
    finally:
        os.umask(before)
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o646


def test_so_many_may_write_one_file(tmp_path: Path) -> None:
    with ExitStack() as stack:
        for number in range(SLOTS):
            stack.enter_context(atomic_write(tmp_path / "a")).write(f"{number}")
        said = rf"a: cannot be written .{SLOTS} other runs .*{os.sep}\.a\.motionkit-0 and others"
        with pytest.raises(MotionkitError, match=said):
            stack.enter_context(atomic_write(tmp_path / "a"))
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.skipif(os.name == "nt", reason="an open file cannot be renamed there")
def test_a_file_is_held_until_it_has_its_name_and_then_let_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest, stays = os.replace, []

    def replace(temporary: str, target: Path) -> None:
        remove_abandoned(temporary)  # as another run does
        stays.append(Path(temporary).exists())
        honest(temporary, target)

    monkeypatch.setattr(os, "replace", replace)

    def free() -> list[int]:
        """The lowest numbers of files that are not open."""
        lowest = [os.open(os.devnull, os.O_RDONLY) for _ in range(4)]
        for number in lowest:
            os.close(number)
        return lowest

    before = free()
    with atomic_write(tmp_path / "a"):
        pass
    assert stays == [True] and free() == before


def test_folders_above_a_file_are_made(tmp_path: Path) -> None:
    for name in ("a", "b"):
        with atomic_write(tmp_path / "new" / "newer" / name):
            pass
    assert len(files_below(tmp_path, ("a", "b"))) == 2


@pytest.mark.parametrize("taken", ["lock", "names_file"])
def test_a_temporary_file_that_another_run_took_for_a_leftover_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, taken: str
) -> None:
    answers = [False]
    honest = getattr(files, taken)
    monkeypatch.setattr(files, taken, lambda *given: answers.pop() if answers else honest(*given))
    with atomic_write(tmp_path / "a") as file:
        assert file.writable() and (tmp_path / ".a.motionkit-1").exists()


def test_a_temporary_file_that_others_removed_is_told_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(MotionkitError, match=r"a: cannot be written .No such file"):
        with atomic_write(tmp_path / "a") as file:
            file.write("x")
            for left in tmp_path.iterdir():
                left.unlink()
    assert not list(tmp_path.iterdir())


def test_a_broken_writer_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(KeyError), atomic_write(tmp_path / "a") as file:
        file.write("x" * 10_000)
        raise KeyError
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]


@pytest.mark.parametrize(
    ("name", "longest", "stays"), [("x" * 80, 80, True), ("x" * 81, 80, False), ("ä" * 40, 80, True)]
)
def test_the_longest_name(name: str, longest: int, stays: bool) -> None:
    safe = safe_name(name, longest)
    assert (safe == name) == stays and len(safe.encode()) == longest


def test_files_with_the_mark_are_ours(tmp_path: Path) -> None:
    (tmp_path / "ours").write_bytes(b"x" * (MARKED_BYTES - 9) + b"motionkit")
    check_foreign([tmp_path / "ours", tmp_path / "missing"])
    for name, data in (("late", b"x" * (MARKED_BYTES - 8) + b"motionkit"), ("empty", b"")):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(OverwriteError, match=f"{name}: was not written by motionkit"):
            check_foreign([tmp_path / "ours", tmp_path / name])
    with pytest.raises(OverwriteError, match="was not written"):
        check_foreign([tmp_path])


def test_files_below_a_folder(tmp_path: Path) -> None:
    assert files_below(tmp_path / "missing", ".bvh") == []
    (tmp_path / "a" / "b").mkdir(parents=True)
    for name in ("a/b/1.BVH", "a/2.bvh", "a/3.txt"):
        (tmp_path / name).touch()
    (tmp_path / "a" / "loop").symlink_to(tmp_path)
    assert [str(path.relative_to(tmp_path)) for path in files_below(tmp_path, ".bvh")] == [
        "a/2.bvh",
        "a/b/1.BVH",
    ]


def stopped_at(step: int, work: Callable[[], object]) -> bool:
    """Run work, with Ctrl-C before its step-th line in the modules that write; whether it came so far."""
    left = step

    def on_line(frame: FrameType, event: str, argument: object) -> object:
        nonlocal left
        left -= event == "line"
        if left == 0:
            sys.settrace(None)
            signal.raise_signal(signal.SIGINT)
        return on_line

    def on_call(frame: FrameType, event: str, argument: object) -> object:
        place = Path(frame.f_code.co_filename).name
        inside = place in ("files.py", "locks.py", "interrupts.py", "contextlib.py")
        return on_line if inside and frame.f_code.co_name != "<genexpr>" else None

    def stop(number: int, frame: FrameType | None) -> None:
        if not postpone(number):
            raise KeyboardInterrupt

    before, tracing = signal.signal(signal.SIGINT, stop), sys.gettrace()
    sys.settrace(on_call)
    try:
        work()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(tracing)
        signal.signal(signal.SIGINT, before)
    return left <= 0


@pytest.mark.parametrize("names", [("a",), pytest.param(("a", "b"), marks=pytest.mark.slow)])
def test_ctrl_c_at_any_line_leaves_whole_files_alone(tmp_path: Path, names: tuple[str, ...]) -> None:
    def work() -> None:
        if len(names) == 1:
            with atomic_write(tmp_path / "a") as file:
                file.write("new" * 5000)
        else:
            write_together({tmp_path / name: b"new" * 5000 for name in names})

    for step in range(1, 2000):
        for name in names:
            (tmp_path / name).write_text("old")
        stopped = stopped_at(step, work)
        assert sorted(path.name for path in tmp_path.iterdir()) == list(names), step
        assert {(tmp_path / name).read_text() for name in names} in ({"old"}, {"new" * 5000}), step
        if not stopped:
            break
    assert 100 < step < 1999


# ---- killed runs, and two at once ----

# Holds a temporary file of "out" or a lock on it until it is killed.
HOLDERS = {
    "file": "from motionkit.files import atomic_write as hold; context = hold('out')",
    "lock": "from motionkit.locks import locked; context = locked(__import__('pathlib').Path('out'), 'making it')",
}


@pytest.fixture(params=HOLDERS)
def holder(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[subprocess.Popen]:
    code = f"import sys; {HOLDERS[request.param]}; context.__enter__(); print('holds', flush=True); sys.stdin.read()"
    running = subprocess.Popen(
        [sys.executable, "-c", code], cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert running.stdout is not None and running.stdout.readline() == b"holds\n"
    running.kind = request.param  # type: ignore[attr-defined]
    yield running
    running.kill()
    running.communicate()


def test_what_a_killed_run_left_is_known_from_what_a_living_one_holds(
    holder: subprocess.Popen, tmp_path: Path
) -> None:
    def write() -> list[str]:
        with locked(tmp_path / "out", "making it") as notes, atomic_write(tmp_path / "out") as file:
            file.write("mine")
        return notes

    is_lock = holder.kind == "lock"  # type: ignore[attr-defined]
    if is_lock:
        with pytest.raises(MotionkitError, match=rf"another run is making it \(process {holder.pid} on "):
            write()
    else:
        write()
    assert len(list(tmp_path.glob(".out.*"))) == 1, "what another run holds stays"
    holder.kill()
    holder.wait()
    told = write()
    assert [f"process {holder.pid} on" in note for note in told] == ([True] if is_lock else [])
    assert [file.name for file in tmp_path.iterdir()] == ["out"] and (tmp_path / "out").read_text() == "mine"


def test_files_of_others_that_look_like_leftovers_stay(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    (tmp_path / ".out.motionkit-0").symlink_to(tmp_path / "mine")
    (tmp_path / ".out.motionkit-1").mkdir()
    (tmp_path / ".out.tmp").touch()
    with atomic_write(tmp_path / "out") as file:
        file.write("new")
    assert {path.name for path in tmp_path.iterdir()} == {
        "mine", "out", ".out.motionkit-0", ".out.motionkit-1", ".out.tmp"
    }  # fmt: skip
    assert (tmp_path / "mine").read_text() == "mine"


def test_files_written_together_stay_if_one_cannot_be_written(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).write_text("old")
    (tmp_path / "c").mkdir()
    with pytest.raises(MotionkitError, match="c: is a folder"):
        write_together({tmp_path / name: b"new" for name in "abc"})
    assert {(tmp_path / name).read_text() for name in "ab"} == {"old"} and len(list(tmp_path.iterdir())) == 3
