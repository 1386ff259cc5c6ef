"""The training loop: windows in, a model file out. A stopped run resumes as if it had never stopped."""

from __future__ import annotations

import json
import math
import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from motionkit.data.dataset import Dataset
from motionkit.data.repeat import repeat_short_types
from motionkit.errors import DatasetError, ModelError, MotionkitError
from motionkit.features.control import ControlLayout
from motionkit.features.layout import FEATURE_COUNT
from motionkit.models.architectures import build
from motionkit.models.bundled import open_model
from motionkit.models.checkpoint import save_model
from motionkit.models.file_check import check_names
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionType
from motionkit.models.network import PartTransformer, parameter_count
from motionkit.models.presets import preset
from motionkit.training.bundle import bundle_model
from motionkit.training.calibration import calibrated_gains, calibrated_noise, with_gains, with_noise
from motionkit.training.losses import Batch, LossOptions, total_loss
from motionkit.training.objective import OwnLosses, TrainingModule
from motionkit.training.optimizer import make_optimizers
from motionkit.training.options import TrainOptions, flat_options
from motionkit.training.presets import FINE_TUNE_MINUTES, fine_tune_options
from motionkit.training.rehearsal import keep_types
from motionkit.training.replay import Replayed
from motionkit.training.run_state import load_run, run_options, save_run
from motionkit.training.sampler import WindowSampler
from motionkit.training.scores import TypeScore, score_rollouts
from motionkit.training.warm_start import check_start, part_way_back, warm_start
from motionkit.training.window_blocks import BlockStart, WindowBlocks

# The paper's loss is a sum over all columns. As a mean, the gradient norm does not depend on their number.
LOSS_SCALE = 1.0 / FEATURE_COUNT
PAPER_FRAMES = 2000 * 60_962 * 300  # of the paper's training: epochs, windows, frames
TWICE = 1.0  # seconds within which two signals are one
# Options that a resumed run may change: its length and its outputs.
FREE_ON_RESUME = ("steps", "minutes", "output.")


@dataclass(frozen=True)
class TrainEvent:
    """A report of a run.

    kind is "prepare" while spliced transitions are made, "step" after every step, "log" after some, "score",
    "checkpoint", "note", or "stop" when Ctrl-C or SIGTERM is heard. share is what is done of the run, or of the
    preparation, 0 to 1.
    """

    kind: str
    step: int
    seconds: float
    losses: dict[str, float]
    scores: tuple[TypeScore, ...] = ()
    text: str = ""
    share: float = 0.0


@dataclass(frozen=True)
class TrainResult:
    """The result of a run; finished is false if it was stopped before its end."""

    model: Path
    steps: int
    seconds: float
    finished: bool
    losses: dict[str, float]


def train(
    dataset_folder: str | Path | Dataset,
    output: str | Path = "model.safetensors",
    options: TrainOptions | None = None,
    resume: bool = False,
    run_folder: str | Path | None = None,
    device: str = "auto",
    on_event: Callable[[TrainEvent], None] | None = None,
) -> TrainResult:
    """Train on a dataset folder and write one model file. Needs torch.

    Args:
        dataset_folder: the folder that preprocess wrote, or a dataset that is open.
        output: the model file, written at the end and on Ctrl-C; an old one is replaced.
        options: from train_options; by default the preset tptn for 5 minutes from the bundled model.
        resume: continue from the run folder's checkpoint, with the same losses as a run without a break.
        run_folder: folder for the checkpoint and log.jsonl; output with the ending ".run" by default.
        device: "auto", "cpu", "cuda" or "cuda:1".
        on_event: called with each report, in the first process only.

    Raises:
        DatasetError: if the dataset does not fit the preset.
        ModelError: if the checkpoint is damaged or does not fit the options.
    """
    options = options or fine_tune_options("tptn", minutes=FINE_TUNE_MINUTES)
    dataset = dataset_folder if isinstance(dataset_folder, Dataset) else Dataset(dataset_folder)
    run = TrainingRun(dataset, Path(output), options, run_folder, device, on_event)
    if resume:
        run.resume()
    return run.go()


def resolve_device(name: str) -> torch.device:
    """Return a device by name; "auto" is CUDA if available. Raises MotionkitError if it is unknown or missing."""
    if name == "auto":
        name = f"cuda:{os.environ.get('LOCAL_RANK', '0')}" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
    except RuntimeError:
        raise MotionkitError(f"unknown device {name!r}, expected auto, cpu, cuda or cuda:1") from None
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise MotionkitError(f"device {name!r} not found; there are {torch.cuda.device_count()} CUDA devices")
    return device


def _use_bfloat16(precision: str, device: torch.device) -> bool:
    """Whether to use bfloat16; "auto" uses it where the processor has instructions for it, since emulation is slow."""
    if precision == "auto":
        if device.type == "cuda":
            return torch.cuda.is_bf16_supported()
        supported = getattr(torch.cpu, "_is_avx512_bf16_supported", lambda: False)
        return bool(supported())
    return precision == "bfloat16"


class TrainingRun:
    """A run of train(), whose arguments it takes."""

    def __init__(
        self,
        dataset: Dataset,
        output: Path,
        options: TrainOptions,
        run_folder: str | Path | None = None,
        device: str = "auto",
        on_event: Callable[[TrainEvent], None] | None = None,
    ) -> None:
        self.dataset, self.output, self.options = dataset, output, options
        self.folder = Path(run_folder) if run_folder else output.with_suffix(".run")
        self.device = resolve_device(device)
        self.rank, self.world = _join_processes(self.device)
        batch = options.optimizer.batch
        if batch % self.world:
            raise DatasetError(f"--batch {batch}: expected a multiple of the {self.world} processes")
        self.on_event = on_event if self.rank == 0 else None
        try:  # before training, not hours later when the model is written
            check_names(list(dataset.types), list(dict.fromkeys(["default", *dataset.characters])))
        except ModelError as error:
            raise DatasetError(f"{dataset.folder}: {error}") from None
        torch.manual_seed(options.seed)
        config = preset(options.preset, **options.config)
        dataset.check_layout(config.layout, f"preset {options.preset} needs")
        self.digest = dataset.digest()
        begun_from = None if options.init is None else open_model(options.init)
        self.kept: dict[str, MotionType] = {}
        self.repeated: tuple[str, ...] = ()
        if begun_from is not None:
            check_start(dataset, begun_from)
            self.repeated = repeat_short_types(dataset)
            if options.sampler.kept_share:
                names = keep_types(dataset, begun_from, options.seed)
                self.kept = {name: begun_from.types[name] for name in names}
        network = build(config, ControlLayout(dataset.types, config.controls).size)
        if begun_from is not None:
            warm_start(network, dataset, begun_from)
        # Kept types are lost less where the weights go part of the way back (training/warm_start.py).
        self.begun = {n: v.clone() for n, v in network.state_dict().items()} if self.kept else None
        self.new_types = () if begun_from is None else tuple(set(dataset.types) - set(begun_from.types))
        # The losses of part transformers have options, and so are not the network's own.
        self.module: OwnLosses | TrainingModule = (
            TrainingModule(network, dataset, options.losses)
            if isinstance(network, PartTransformer)
            else OwnLosses(network, dataset)
        ).to_device(self.device)
        self.trainable: nn.Module = self.module
        if self.world > 1:
            ids = [self.device.index] if self.device.type == "cuda" else None
            self.trainable = DistributedDataParallel(self.module, device_ids=ids)
        # Dropout must differ between processes, weights must not.
        torch.manual_seed(options.seed + 1 + self.rank)
        self.autocast = _use_bfloat16(options.optimizer.precision, self.device)
        if self.device.type == "cuda":  # tensor cores round factors to 10 bits; sums are in float32
            torch.set_float32_matmul_precision("high")
        self.optimizers = make_optimizers(self.module, network, options.optimizer, self.autocast)
        self.average = {n: p.detach().clone() for n, p in self.module.network.state_dict().items()}
        self.step, self.seconds = 0, 0.0
        self.losses: dict[str, float] = {}
        self.scores: tuple[TypeScore, ...] = ()
        # Reference gains, and noise without references, found at the end.
        self.gains: dict[str, float] = {}
        self.noises: dict[str, float] = {}
        kept, controls = tuple(self.kept), config.controls
        self.sampler = WindowSampler(dataset, options.sampler, options.seed, kept, controls)
        share = batch // self.world
        places = range(self.rank * share, (self.rank + 1) * share)
        self.blocks = WindowBlocks(self.sampler, network, options, places)
        self._block: BlockStart | None = None  # of the checkpoint that the run resumes from
        # On a GPU a step is a graph, made anew for other losses.
        self._replayed = Replayed(lambda *_: ())
        self._loss_options: LossOptions | None = None
        self._terms: list[str] = []
        self.asked_to_stop = self.stops = False
        self.logs = True  # false once writing log.jsonl has failed

    @property
    def checkpoint(self) -> Path:
        return self.folder / "checkpoint.safetensors"

    def resume(self) -> None:
        """Load the checkpoint. Its options and clips must equal those of this run, except FREE_ON_RESUME."""
        if not self.checkpoint.is_file():
            raise DatasetError(f"{self.checkpoint}: no checkpoint to resume from")
        # Earlier releases had AdamW alone and did not write it.
        before = {"optimizer.method": "adamw"} | run_options(self.checkpoint)
        now = flat_options(json.loads(json.dumps(self.options.to_dict())))
        changed = [k for k in before if k in now and before[k] != now[k] and not k.startswith(FREE_ON_RESUME)]
        if changed:
            words = ", ".join(f"{name} {before[name]!r:.60} (now {now[name]!r:.60})" for name in changed)
            raise ModelError(
                f"{self.checkpoint}: the run was started with {words}; resume it with the same options"
            )
        facts, block = load_run(self.checkpoint, self.module, self.average, self.optimizers)
        if facts.get("data", self.digest) != self.digest:  # earlier releases have not written it
            raise DatasetError(
                f"{self.checkpoint}: the run was started with other training clips than those of "
                f"{self.dataset.folder}; resume it with the same, or delete {self.folder} and start anew"
            )
        self.step, self.seconds = int(facts["step"]), float(facts["seconds"])
        self._block = block

    def progress(self) -> float:
        """Return the share of the run that is done, 0 to 1."""
        shares = [0.0]
        if self.options.steps:
            shares.append(self.step / self.options.steps)
        if self.options.minutes:
            shares.append(self.seconds / (60.0 * self.options.minutes))
        return min(1.0, max(shares))

    def learning_rate(self) -> float:
        """Return the rate of this step: linear warm-up, then a cosine down to a small share of the peak.

        The paper halves the rate every 500 of 2000 epochs, so at every quarter of the run.
        """
        options = self.options.optimizer
        warm = min(1.0, (self.step + 1) / max(1, options.warmup))
        if options.schedule == "halving":
            return options.rate * warm * 0.5 ** min(3, math.floor(4.0 * self.progress()))
        cosine = 0.5 * (1.0 + math.cos(math.pi * self.progress()))
        return options.rate * warm * (options.final_rate + (1.0 - options.final_rate) * cosine)

    def go(self) -> TrainResult:
        for folder in (self.folder, self.output.parent):  # fails now, not after hours
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise MotionkitError(
                    f"{folder}: cannot be written ({error.strerror or error}); choose another --run-folder or -o"
                ) from None
        if self.step == 0 and self.rank == 0:
            self._clear()
        self._note(f"{parameter_count(self.module.network) / 1e6:.2f} M parameters on {self.device}")
        if self.repeated:
            self._note(f"recordings of {', '.join(self.repeated)} repeated: they are few and short")
        self.sampler.make_splices(lambda share: self._emit("prepare", share=share))
        self._note(f"{len(self.sampler.splices)} spliced transitions")
        if self._block is not None:
            self.blocks.resume(self.step, self._block)
        for line in self._schedule_notes():
            self._note(line)
        previous = self._catch_signals()
        finished = False
        try:
            self._loop()
            finished = self.progress() >= 1.0
            if self.rank == 0:
                self._save_all()
        finally:
            self.blocks.close()
            for number, handler in previous.items():
                signal.signal(number, handler)
        if self.rank == 0:
            if not finished:
                self._note("stopped; continue with --resume")
            elif self._calibrate_and_score():
                self._save_model()  # again, with reference gains, and scores in the card
        if self.world > 1:
            dist.barrier()  # all processes stopped at the same step
            dist.destroy_process_group()
        return TrainResult(self.output, self.step, self.seconds, finished, self.losses)

    def _schedule_notes(self) -> list[str]:
        """Say how the run compares with the paper's schedule (section 4.3), if windows are cut as it does."""
        options, cuts = self.options, len(self.sampler.cuts)
        if not cuts or not options.steps:
            return []
        batch, window = options.optimizer.batch, options.sampler.window
        share = 100.0 * options.steps * batch * window / PAPER_FRAMES
        return [
            f"{cuts} windows; {options.steps} steps of {batch} x {window} frames are "
            f"{options.steps * batch / cuts:.2f} epochs and {share:.3g} % of the "
            f"paper's frames; rate {options.optimizer.rate:g}, halved every {-(-options.steps // 4)} steps "
            "(paper: 0.0001, every 500 of 2000 epochs)"
        ]

    def _catch_signals(self) -> dict[int, Any]:
        """Make Ctrl-C and SIGTERM end the run after the current step, because a checkpoint holds whole steps only.

        A second one, not before a second later, ends it at once: timeout and torchrun send one twice.
        """
        heard = 0.0

        def stop(number: int, frame: Any) -> None:
            nonlocal heard
            if self.asked_to_stop:
                if time.monotonic() - heard > TWICE:
                    raise KeyboardInterrupt
                return
            self.asked_to_stop, heard = True, time.monotonic()
            self._emit("stop", "stopping after this step")

        try:
            return {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
        except ValueError:  # not in the main thread
            return {}

    def _loop(self) -> None:
        saved = scored = time.monotonic()
        clock = time.monotonic()
        while self.progress() < 1.0:
            self.losses = self._train_step()
            now = time.monotonic()
            self.seconds, clock = self.seconds + now - clock, now
            if self.world > 1 and self.options.minutes:
                self.seconds = self._agree(self.seconds)
            self._emit("step")
            if self.step % self.options.output.log_every == 0 or self.progress() >= 1.0:
                self._emit("log")
            if self.rank == 0 and now - saved > self.options.output.checkpoint_seconds:
                self._attempt("the checkpoint", self._save_checkpoint)
                saved = time.monotonic()
            if self.rank == 0 and now - scored > 60.0 * self.options.output.score_minutes:
                self._score()
                scored = time.monotonic()
            if self.stops or (self.world == 1 and self.asked_to_stop):
                return

    def _agree(self, seconds: float) -> float:
        """Return the first process's clock, so that all processes stop at the same step."""
        value = torch.tensor([seconds], device=self.device, dtype=torch.float64)
        dist.broadcast(value, 0)
        return float(value)

    def _train_step(self) -> dict[str, float]:
        options = self.options
        self.trainable.train()
        if self.world > 1:
            # Dropout must differ between processes and be the same after a resume, but the checkpoint holds
            # the random state of the first process only. So each step seeds it.
            torch.manual_seed((options.seed + 1) * 1_000_003 + self.step * self.world + self.rank)
        batch = self.blocks.next(self.step, self.progress())
        options = self.blocks.options
        rate = self.learning_rate()
        for group in (group for each in self.optimizers for group in each.param_groups):
            group["lr"] = rate
        terms = self.gradients(batch, options.losses)
        norm = nn.utils.clip_grad_norm_(self.module.parameters(), options.optimizer.clip_norm)
        if math.isfinite(float(norm)):
            for each in self.optimizers:
                each.step()
            self.update_average()
        self.step += 1
        stop = norm.new_tensor(float(self.asked_to_stop))  # all processes stop at the same step
        shared = torch.stack([*terms.values(), norm.detach(), stop])
        if self.world > 1:
            dist.all_reduce(shared)
            shared = shared / self.world
        *means, stops = shared.tolist()
        self.stops = stops > 0
        return dict(zip([*terms, "gradient"], means, strict=True))

    def gradients(self, batch: Batch, options: LossOptions) -> dict[str, Tensor]:
        """Compute the gradients of a batch; return the terms of the loss by name, and their "total"."""
        if options != self._loss_options:  # a new stage: a graph of its own
            self._loss_options = options
            self.module.use(options)
            self._replayed = Replayed(lambda *given: tuple(self._gradients(Batch(*given), options).values()))
        # A graph would keep the progress of its capture, which networks with losses of their own are given.
        if not isinstance(self.module, TrainingModule) or self.world > 1:
            return self._gradients(batch, options)
        values = self._replayed(*vars(batch).values())
        return dict(zip(self._terms, values, strict=True))

    def _gradients(self, batch: Batch, options: LossOptions) -> dict[str, Tensor]:
        for each in self.optimizers:
            each.zero_grad(set_to_none=True)
        terms = self.trainable(batch, self.autocast, self.progress())
        weights = {} if isinstance(self.module, OwnLosses) else options.weights
        loss = total_loss(terms, weights) * LOSS_SCALE
        loss.backward()
        found = {name: value.detach() for name, value in terms.items()} | {
            "total": loss.detach() / LOSS_SCALE
        }
        self._terms = list(found)
        return found

    @torch.no_grad()
    def update_average(self) -> None:
        """Let the running average follow the weights."""
        # At first the average follows quickly, so that it forgets the random initial weights.
        decay = min(self.options.optimizer.ema, (1.0 + self.step) / (10.0 + self.step))
        state = self.module.network.state_dict()
        averages = list(self.average.values())
        torch._foreach_lerp_(averages, [state[n] for n in self.average], 1.0 - decay)

    def _save_all(self) -> None:
        """Write the model and the checkpoint, each even if the other fails. Raises the first error at the end."""
        faults = []
        for save in (self._save_model, self._save_checkpoint):
            try:
                save()
            except MotionkitError as fault:
                faults.append(fault)
        if faults:
            raise faults[0]

    def _save_model(self) -> None:
        save_model(self.output, self.model(), self.options.output.half)

    def _attempt(self, what: str, work: Callable[[], None]) -> bool:
        """Do optional work: an error becomes a note instead of ending hours of training."""
        try:
            work()
        except Exception as fault:
            self._note(
                f"{what} failed, the run continues: {' '.join(str(fault).split()) or type(fault).__name__}"
            )
            return False
        return True

    def _save_checkpoint(self) -> None:
        facts = {
            "step": self.step,
            "seconds": self.seconds,
            "options": self.options.to_dict(),
            "data": self.digest,
        }
        save_run(self.checkpoint, self.module, self.average, self.optimizers, facts, self.blocks.unfinished)
        self._emit("checkpoint")

    def model(self) -> MotionModel:
        """Return the current model: averaged weights, on the CPU."""
        with torch.random.fork_rng(devices=[]):  # leaves the random state of the run alone
            network = build(self.module.network.config, self.module.network.control_size)
        weights = {n: t.cpu() for n, t in self.average.items()}
        if self.begun is not None:
            layout = ControlLayout(self.dataset.types, self.module.network.config.controls)
            weights = part_way_back(weights, self.begun, layout, self.new_types)
        network.load_state_dict(weights)
        card = {
            "dataset": {"clips": len(self.dataset.clips), "types": list(self.dataset.types)},
            "options": self.options.to_dict(),
            "steps": self.step,
            "seconds": round(self.seconds, 1),
            "losses": {n: round(v, 5) for n, v in self.losses.items()},
            "scores": {s.type: s.to_dict() for s in self.scores},
        }
        references = (
            self.options.sampler.controls.reference_dropout < 1.0 and network.config.controls == "extended"
        )
        model = bundle_model(network.weights(), self.dataset, card, references, self.kept)
        return with_noise(with_gains(model, self.gains), self.noises)

    def _calibrate_and_score(self) -> bool:
        """Find the sampling presets and score roll-outs, if the options ask for scores; say whether either worked."""
        frames = int(self.options.output.score_seconds * self.dataset.fps)
        calibrated = frames > 0 and self._attempt("the sampling presets", lambda: self._calibrate(frames))
        return self._score() or calibrated

    def _calibrate(self, frames: int) -> None:
        # There are many of these roll-outs: half the length of those that are scored will do.
        gains = calibrated_gains(self.model(), self.dataset, frames // 2)
        self.gains = {kind: gain for kind, gain in gains.items() if kind not in self.kept}
        noises = calibrated_noise(self.model(), self.dataset, frames // 2)
        self.noises = {kind: noise for kind, noise in noises.items() if kind not in self.kept}

    def _score(self) -> bool:
        """Score roll-outs and write samples, if the options ask for it, and return whether that worked."""
        threads, random_state = torch.get_num_threads(), torch.get_rng_state()
        frames = int(self.options.output.score_seconds * self.dataset.fps)
        scored = frames > 0 and self._attempt("the score", lambda: self._score_rollouts(frames))
        torch.set_num_threads(threads)
        torch.set_rng_state(random_state)
        return scored

    def _score_rollouts(self, frames: int) -> None:
        self.scores = score_rollouts(self.model(), self.dataset, frames, self.folder / "samples", self._note)
        self._emit("score")

    def _note(self, text: str) -> None:
        self._emit("note", text)

    def _emit(self, kind: str, text: str = "", share: float | None = None) -> None:
        if self.rank != 0:
            return
        event = TrainEvent(
            kind,
            self.step,
            self.seconds,
            self.losses,
            self.scores if kind == "score" else (),
            text,
            self.progress() if share is None else share,
        )
        if kind in ("log", "score"):
            line: dict[str, Any] = {"kind": kind, "step": self.step, "seconds": round(self.seconds, 2)}
            line |= {"rate": self.learning_rate()} | self.losses if kind == "log" else {}
            if kind == "score":
                line["scores"] = {s.type: s.to_dict() for s in self.scores}
            self._log(json.dumps(line))
        if self.on_event:
            self.on_event(event)

    def _clear(self) -> None:
        """Remove what an earlier run has left in the folder: it would be taken for this one's."""
        stale = [self.folder / "checkpoint.safetensors"]
        stale += [file for name in ("samples", "preview") for file in self.folder.glob(f"{name}/*.bvh")]
        with suppress(OSError):  # writing says what is wrong
            if (self.folder / "log.jsonl").exists():
                (self.folder / "log.jsonl").open("w").close()
            for file in stale:
                file.unlink(missing_ok=True)

    def _log(self, line: str) -> None:
        """Add a line to log.jsonl. After an error, such as a full disk, the run continues without the log."""
        if not self.logs:
            return
        try:
            with (self.folder / "log.jsonl").open("a", encoding="utf-8", newline="\n") as file:
                file.write(line + "\n")
        except OSError as fault:
            self.logs = False
            self._note(f"cannot write log.jsonl ({fault.strerror or fault}); the run continues without it")


def _join_processes(device: torch.device) -> tuple[int, int]:
    """Return rank and number of processes; joins the process group of torchrun, if there is one."""
    if "RANK" not in os.environ or int(os.environ.get("WORLD_SIZE", "1")) < 2:
        return 0, 1
    if not dist.is_initialized():
        dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    return dist.get_rank(), dist.get_world_size()
