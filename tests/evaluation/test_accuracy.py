from __future__ import annotations

import numpy as np

from motionkit.control.script import TypePart
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.evaluation.accuracy import Judge, measure_accuracy
from motionkit.evaluation.body import Body, body_of
from motionkit.evaluation.real import RealMotion
from motionkit.evaluation.rolling import Plan, roll_plans
from motionkit.evaluation.settings import EvaluationSettings
from motionkit.inference.rollout import Noise
from motionkit.models.model import MotionModel
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from synthetic_motions import make_idle, make_walk


def test_a_batch_moves_as_synthesize_does(tiny_model: MotionModel) -> None:
    parts = [TypePart("idle", 0.2), TypePart("walking", 0.4)]
    still = Noise("mean")
    found = roll_plans(tiny_model, [Plan(tuple(parts), 0), Plan(tuple(parts), 0)], still)
    alone = synthesize(tiny_model, parts, SynthesisOptions(ik=False, noise=still)).motions[0].motion
    for each in found:
        assert np.allclose(each.body.positions, motion_kinematics(alone)[1], atol=1e-2)
        assert np.array_equal(each.motion(tiny_model).root_positions, each.body.positions[:, 0])


def test_plans_differ_in_what_is_asked(tiny_model: MotionModel) -> None:
    plans = [Plan((TypePart(kind, 0.3),), choice) for kind in ("walking", "cartwheel") for choice in (0, 1)]
    found = roll_plans(tiny_model, plans, Noise("mean"))
    assert len(found) == 4 and {len(p.body) for p in found} == {18}
    assert not np.allclose(found[0].body.positions, found[2].body.positions)


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


def test_every_type_is_commanded_with_every_seed(tiny_model: MotionModel, real: RealMotion) -> None:
    settings = EvaluationSettings(seeds=2, accuracy_seconds=1.5)
    lengths = []

    class OnlyWalking(Judge):
        def performs(self, kind: str, body: Body) -> bool:
            lengths.append(len(body))
            return kind == "walking"

    found = measure_accuracy(tiny_model, OnlyWalking(real), settings, ("walking", "cartwheel"))
    assert [each.type for each in found] == ["walking", "cartwheel"]
    assert lengths == 4 * [round(1.5 * tiny_model.fps)], "only what follows the command is judged"
    assert [(each.rollouts, each.shown, each.share) for each in found] == [(2, 2, 1.0), (2, 0, 0.0)]
    assert found[0].training_clips == 2 and found[1].training_clips == 1
