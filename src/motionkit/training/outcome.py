"""The resulting model of a run: averaged weights, sampling presets, and scores of roll-outs."""

from __future__ import annotations

from pathlib import Path

import torch

from motionkit.data.dataset import Dataset
from motionkit.models.architectures import build
from motionkit.models.checkpoint import save_model
from motionkit.models.model import MotionModel
from motionkit.training.bundle import bundle_model
from motionkit.training.calibration import calibrated_gains, calibrated_noise, training_judge, with_presets
from motionkit.training.initial_network import InitialNetwork
from motionkit.training.learner import Learner
from motionkit.training.report import RunReport
from motionkit.training.scores import TypeScore, score_rollouts


class Outcome:
    """Makes, scores and writes the model of a run."""

    def __init__(
        self, path: Path, dataset: Dataset, initial: InitialNetwork, learner: Learner, report: RunReport
    ) -> None:
        self.path, self.dataset, self.initial = path, dataset, initial
        self.learner, self.report = learner, report
        self.options = report.progress.options
        self.frames = int(self.options.output.score_seconds * dataset.fps)  # per roll-out; 0 for no scores
        self.scores: tuple[TypeScore, ...] = ()
        # By type, calibrated at the end of the run: reference gains, and noise without references.
        self.gains: dict[str, float] = {}
        self.noises: dict[str, float] = {}

    def save(self) -> None:
        """Write the model file."""
        save_model(self.path, self.model(), self.options.output.half)

    def model(self) -> MotionModel:
        """Return the present model, with averaged weights, on the CPU."""
        trained, at = self.learner.network, self.report.progress
        with torch.random.fork_rng(devices=[]):  # keeps the random state of the run
            network = build(trained.config, trained.control_size)
        network.load_state_dict(self.initial.towards_initial(self.learner.averages()[0]))
        card = {
            "dataset": {"clips": len(self.dataset.clips), "types": list(self.dataset.types)},
            "options": self.options.to_dict(),
            "steps": at.step,
            "seconds": round(at.seconds, 1),
            "losses": {n: round(v, 5) for n, v in at.losses.items()},
            "scores": {s.type: s.to_dict() for s in self.scores},
        }
        with_references = self.options.sampler.controls.reference_dropout < 1.0
        references = with_references and network.config.controls == "extended"
        model = bundle_model(network.weights(), self.dataset, card, references, self.initial.kept)
        model = with_presets(model, "reference_gain", self.gains)
        return with_presets(model, "noise_alone", self.noises)

    def calibrate_and_score(self) -> bool:
        """Calibrate sampling presets and score roll-outs if options ask for scores; return whether either succeeded."""
        calibrated = self.frames > 0 and self.report.attempt("the sampling presets", self._calibrate)
        return self.score() or calibrated

    def _calibrate(self) -> None:
        # Calibration takes many roll-outs, so they have half the length of scored ones.
        kept, frames, stage = self.initial.kept, self.frames // 2, self.report.stage
        tell = stage("calibrating reference poses")
        judge = training_judge(self.dataset)
        gains = calibrated_gains(self.model(), judge, frames, progress=tell)
        self.gains = {kind: gain for kind, gain in gains.items() if kind not in kept}
        tell = stage("calibrating noise")
        noises = calibrated_noise(self.model(), judge, frames, progress=tell)
        self.noises = {kind: noise for kind, noise in noises.items() if kind not in kept}

    def score(self) -> bool:
        """Score roll-outs and write samples if the options ask for scores; return whether that succeeded."""
        threads, random_state = torch.get_num_threads(), torch.get_rng_state()
        scored = self.frames > 0 and self.report.attempt("the score", self._score)
        torch.set_num_threads(threads)
        torch.set_rng_state(random_state)
        return scored

    def _score(self) -> None:
        samples = self.report.folder / "samples"
        tell = self.report.stage("scoring")
        self.scores = score_rollouts(
            self.model(), self.dataset, self.frames, samples, self.report.note, progress=tell
        )
        self.report.emit("score", scores=self.scores)
