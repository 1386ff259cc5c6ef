"""The schedule of the server, on a clock that only moves when told."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from motionkit.play.pace import Pacer

FRAME = 1 / 60


def run(pacer: Pacer, steps: list[float]) -> tuple[list[float], list[bool]]:
    """Times at which frames with these step durations are sent, and whether each changed `behind`."""
    now, sent, changes = pacer.due - FRAME, [], []
    for step in steps:
        now = max(now, pacer.begin) + step
        pacer.made(step)
        now = max(now, pacer.due)
        changes.append(pacer.sent(now))
        sent.append(now)
    return sent, changes


def test_frames_leave_on_deadlines_that_do_not_drift() -> None:
    generator = random.Random(1)
    sent, changes = run(Pacer(60, 100.0), [generator.uniform(0.001, 0.006) for _ in range(3600)])
    for i, when in enumerate(sent[10:], 11):
        assert 0.0 <= when - (100.0 + i * FRAME) + 1e-6 < 0.0015
    assert not any(changes)


def test_a_step_begins_just_before_its_deadline() -> None:
    pacer = Pacer(60, 0.0)
    run(pacer, [0.002] * 200)
    assert 0.002 <= pacer.due - pacer.begin < 0.003


def test_one_late_frame_does_not_hurry_the_next_ones() -> None:
    pacer = Pacer(60, 0.0)
    sent, changes = run(pacer, [0.002] * 60 + [0.100] + [0.002] * 60)
    gaps = [b - a for a, b in pairwise(sent)]
    assert max(gaps) < 0.12
    assert min(gaps) > 0.49 * FRAME, "no burst to make up for it"
    assert all(gap == pytest.approx(FRAME, abs=1e-6) for gap in gaps[70:])
    assert not any(changes), "one hiccup is not being behind"


def test_a_little_late_is_made_up_for() -> None:
    pacer = Pacer(60, 0.0)
    sent, _ = run(pacer, [0.002] * 30 + [0.009] + [0.002] * 30)
    assert sent[-1] == pytest.approx(61 * FRAME, abs=1e-6)


def test_a_slow_machine_slows_evenly_and_says_so_once() -> None:
    pacer = Pacer(60, 0.0)
    sent, changes = run(pacer, [0.002] * 120 + [0.025] * 200)
    gaps = [b - a for a, b in pairwise(sent[125:])]
    assert max(gaps) - min(gaps) < 1e-6 and gaps[0] == pytest.approx(0.025)
    assert changes.count(True) == 1 and pacer.behind
    assert pacer.fps == pytest.approx(40.0, rel=0.03)
    assert pacer.step_seconds == pytest.approx(0.025, rel=0.01)


def test_it_says_when_it_keeps_up_again() -> None:
    pacer = Pacer(60, 0.0)
    run(pacer, [0.025] * 200)
    assert pacer.behind
    _, changes = run(pacer, [0.002] * 200)
    assert changes.count(True) == 1 and not pacer.behind


def test_it_does_not_say_so_more_than_once_a_second() -> None:
    pacer = Pacer(60, 0.0)
    sent, changes = run(pacer, ([0.040] * 20 + [0.001] * 20) * 30)
    told = [when for when, change in zip(sent, changes, strict=True) if change]
    assert all(b - a >= 1.0 for a, b in pairwise(told))
