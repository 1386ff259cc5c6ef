from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.lab.scoreboard.accuracy import TypeAccuracy, accuracy_section, is_reached, measure_accuracy
from motionkit.lab.scoreboard.settings import EvaluationSettings
from motionkit.metrics.body import Body, body_of
from motionkit.metrics.detectors import DETECTORS
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.training.verdict.judge import Judge
from motionkit.training.verdict.real import MotionProfile, RealMotion
from synthetic_motions import make_idle, make_walk

from .conftest import TINY


def test_lasting_types_must_last_and_others_occur_once(real: RealMotion) -> None:
    judge = Judge(real)
    walk, stand = make_walk(300, turn=0.0), make_idle(300)
    both = Motion(
        walk.skeleton,
        np.concatenate([walk.local_rotations, stand.local_rotations]),
        np.concatenate([walk.root_positions, stand.root_positions + walk.root_positions[-1]]),
        60.0,
    )
    assert judge.performs("walking", body_of(walk))
    assert not judge.performs("walking", body_of(both))
    assert judge.window("cartwheel") == 0.0
    wheel = real.of_type("cartwheel")[0].body
    assert judge.performs("cartwheel", wheel) and not judge.performs("cartwheel", body_of(stand))


def test_a_type_without_a_detector_must_move_as_fast_as_its_recordings(
    real: RealMotion, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(DETECTORS, "walking")
    judge = Judge(real)
    profile = real.profile("walking")
    assert profile is not None and profile.judges and judge.knows("walking")
    monkeypatch.setattr(MotionProfile, "shows", lambda self, body, distances: True)
    body = body_of(make_walk(300, turn=0.0))
    ratio = judge.speed_ratio("walking", body)
    assert ratio == pytest.approx(body.joint_speed() / profile.joint_speed)
    for usual, shown in (((0.5, 1.0), True), ((1.0, 2.0), True), ((0.2, 0.6), False), ((1.6, 2.0), False)):
        # A roll-out is held against calm and busy recordings, not against their mean.
        slowest, fastest = (share * body.joint_speed() for share in usual)
        changed = replace(profile, usual=(slowest, fastest))
        monkeypatch.setattr(real, "profile", lambda kind, changed=changed: changed)
        assert judge.performs("walking", body) == shown
    monkeypatch.setattr(real, "profile", lambda kind: profile)
    assert not judge.performs("walking", body_of(make_walk(300, turn=0.0, swing=0.05)))


def test_one_recording_judges_no_type(real: RealMotion, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(DETECTORS, "cartwheel")
    assert len(real.of_type("cartwheel", "train")) == 1
    profile = real.profile("cartwheel")
    assert profile is not None and not profile.judges
    assert not Judge(real).knows("cartwheel") and not Judge(real).knows("unheard-of")


def test_every_type_is_commanded_with_every_seed(
    make_trial, tiny_model: MotionModel, real: RealMotion
) -> None:
    lengths = []

    class OnlyWalking(Judge):
        def performs(self, kind: str, body: Body) -> bool:
            lengths.append(len(body))
            return kind == "walking"

    settings = EvaluationSettings(seeds=2, accuracy_seconds=1.5)
    found = measure_accuracy(make_trial(settings, OnlyWalking(real)), ("walking", "cartwheel"))
    assert [each.type for each in found] == ["walking", "cartwheel"]
    assert lengths == 8 * [round(1.5 * tiny_model.fps)], (
        "only what follows the command is judged, raw motion too"
    )
    assert [(each.rollouts, each.detected, each.share) for each in found] == [(2, 2, 1.0), (2, 0, 0.0)]
    assert found[0].training_clips == 2 and found[1].training_clips == 1


def test_a_column_has_the_model_without_references(make_trial) -> None:
    section = accuracy_section(make_trial(), lambda share: None)
    columns = section.tables[0].columns
    assert "without references" in columns and "raw" in columns
    assert any("without reference recordings" in goal.what for goal in section.goals)
    alone = accuracy_section(make_trial(replace(TINY, reference="none")), lambda share: None)
    assert "without references" not in alone.tables[0].columns


@pytest.mark.parametrize(
    ("share", "speed", "detector", "shown"),
    [(20, 1.0, False, True), (20, 0.18, False, False), (18, 1.0, False, False), (20, 0.18, True, True)],
)
def test_a_type_that_is_too_slow_in_the_mean_is_not_shown(
    real: RealMotion, monkeypatch: pytest.MonkeyPatch, share: int, speed: float, detector: bool, shown: bool
) -> None:
    """Some recordings may be that calm, so that each roll-out is within their limits."""
    if not detector:
        monkeypatch.delitem(DETECTORS, "cartwheel")
    each = TypeAccuracy("cartwheel", 20, share, None, speed, 9)
    assert is_reached(Judge(real), each) == shown
