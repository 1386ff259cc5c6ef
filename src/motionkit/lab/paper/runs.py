"""One run of an experiment: train, roll out, measure, and write one small JSON file. What is done is skipped."""

from __future__ import annotations

import json
import platform
import re
import tempfile
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from motionkit.data.dataset import Dataset
from motionkit.errors import MotionkitError
from motionkit.files import read_json, write_json
from motionkit.lab.floors import FLOORS
from motionkit.lab.held_out import held_out
from motionkit.lab.paper.batched_rollouts import roll_out
from motionkit.lab.paper.datasets import described, select
from motionkit.lab.paper.held_out_errors import control_derivatives, held_out_errors
from motionkit.lab.paper.kept_rollouts import OUTPUTS, keep_rollouts, read_rollouts, rollouts_file
from motionkit.lab.paper.model_results import check_result, made_from
from motionkit.lab.paper.protocol import LONGEST, measure
from motionkit.lab.paper.side_by_side import side_by_side
from motionkit.lab.paper.variants import VARIANTS, Variant, chosen, parameters, variant
from motionkit.lab.statistics import rounded
from motionkit.locks import locked
from motionkit.models.architectures import network_class
from motionkit.models.checkpoint import load_model
from motionkit.models.network import parameter_count
from motionkit.models.predictor import Predictor
from motionkit.training.budgets import BUDGETS
from motionkit.training.options import TrainOptions
from motionkit.training.presets import train_options
from motionkit.training.report import TrainEvent
from motionkit.training.trainer import train

CURVE_POINTS = 100  # points of a training curve in a result


@dataclass(frozen=True)
class Plan:
    """What all runs of a call have in common: equal budgets.

    Attributes:
        selection: which data set of it (lab/paper/datasets.py).
        steps: training steps; the budget's by default.
        results, checkpoints: folders to write to.
        longest: frames that are made of a test sequence at most.
    """

    data: Path
    selection: str = "D_L"
    budget: str = "cpu"
    steps: int | None = None
    results: Path = Path("experiments/results")
    checkpoints: Path = Path("experiments/checkpoints")
    longest: int = LONGEST
    device: str = "auto"

    @property
    def folder(self) -> str:
        """Name of the folder for runs of this budget."""
        return f"{self.selection}/{self.budget}" + ("" if self.steps is None else f"-{self.steps}")


def slug(name: str) -> str:
    """Return a variant's name as it stands in file names."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def result_file(plan: Plan, each: Variant, seed: int) -> Path:
    """Return where the result of a run is written."""
    return plan.results / plan.folder / f"{slug(each.name)}-{seed}.json"


def options_of(plan: Plan, each: Variant, seed: int) -> TrainOptions:
    """Return the training options of a run: the budget's, with what the variant changes."""
    return train_options(
        each.preset,
        steps=plan.steps,
        budget=plan.budget,
        config=dict(each.config),
        seed=seed,
        score_seconds=0.0,
        log_every=10,
        **each.options,
    )


def is_done(plan: Plan, each: Variant, seed: int, made: dict[str, str] | None) -> bool:
    """Return whether the result of a run is there; made is what a result of now would be made from, if that is known.

    Raises:
        MotionkitError: the result is damaged, or was made from other data, by other training, or with another number
            of frames.
    """
    file = result_file(plan, each, seed)
    if not file.exists():
        return False
    result = read_result(file)
    if result["longest"] != plan.longest:
        raise MotionkitError(
            f"{file}: made with --frames {result['longest']}, not {plan.longest}; give these, choose another "
            "--results, or delete it"
        )
    if "budget" in result:
        found, expected = result["budget"], budget_of(plan.budget, options_of(plan, each, seed), 0)
        other = [name for name in expected if name != "steps" and found.get(name) != expected[name]]
        if other:
            raise MotionkitError(
                f"{file}: made with another {other[0]} of training; choose another --results, or delete it"
            )
    if made:
        _check_clips(file, result["made"], made, f"{plan.data} ({plan.selection})")
    return True


Task = tuple[Variant, int]  # with a seed


def tasks_of(plan: Plan, names: tuple[str, ...], seeds: int, every_seed: bool = False) -> list[Task]:
    """Return the runs that names, groups and "all" stand for at the plan's budget, the first seed of everything first.

    Networks have as many seeds as their table needs, or all with every_seed; floors have one.
    """
    variants = [each for each in chosen(names) if each.runs_at(plan.budget)]
    needed = {each.name: (seeds if every_seed else each.seeds) if each.preset else 1 for each in variants}
    return [(each, seed) for seed in range(seeds) for each in variants if seed < needed[each.name]]


def unfinished(plan: Plan, tasks: Sequence[Task]) -> list[Task]:
    """Return the runs without a result, once it is known that theirs can be written.

    Raises:
        MotionkitError: a result is there that is damaged, or of other data or other frames; or none can be written.
    """
    made = made_from(select(plan.data, plan.selection))
    left = [(each, seed) for each, seed in tasks if not is_done(plan, each, seed, made)]
    if left:
        check_writable(plan)
    return left


def listed(plan: Plan, known: bool) -> tuple[list[dict[str, Any]], list[str]]:
    """Return a row for each variant, and why results are not counted; `known` says whether the dataset is there."""
    made = made_from(select(plan.data, plan.selection)) if known else None
    minutes, faults = _usual_minutes(plan), list[str]()

    def counts(each: Variant, seed: int) -> bool:
        try:
            return is_done(plan, each, seed, made)
        except MotionkitError as error:
            faults.append(str(error))
            return False

    rows = [
        {
            "name": each.name,
            "group": each.group,
            "text": each.text,
            "parameters": parameters(each),
            "paper_parameters": each.paper_parameters,
            "seeds": each.seeds,
            "done": sum(counts(each, seed) for seed in range(each.seeds)),
            "minutes": minutes.get(each.name),
        }
        for each in VARIANTS
    ]
    return rows, faults


def _usual_minutes(plan: Plan) -> dict[str, float]:
    """Minutes that runs of this folder took here; files that are no results are left out."""
    minutes = {}
    for path in (plan.results / plan.folder).glob("*.json"):
        with suppress(MotionkitError):
            result = read_result(path)
            if "timing" in result:
                minutes[result["name"]] = result["timing"]["seconds"] / 60
    return minutes


def check_writable(plan: Plan) -> None:
    """Check that results and checkpoints can be written, before hours of training. Raises MotionkitError if not."""
    for folder in (plan.results / plan.folder, plan.checkpoints / plan.folder):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError as error:
            raise MotionkitError(
                f"{folder}: cannot be written ({error.strerror or error}); choose another --results"
            ) from None


def run_one(
    plan: Plan,
    each: Variant,
    seed: int,
    say: Callable[[str], None],
    progress: Callable[[float], None],
    trained: bool = False,
) -> Path:
    """Do one run unless its result is there, and return its file.

    Args:
        trained: whether the model is there already, and only its test is missing.

    Raises:
        DatasetError: if the dataset does not fit.
        MotionkitError: a result is there that is damaged, or of other data or frames, or another process makes it.
    """
    file = result_file(plan, each, seed)
    dataset = select(plan.data, plan.selection)
    made = made_from(dataset)
    with locked(file, "making this result") as notes:
        for line in notes:
            say(line)
        if is_done(plan, each, seed, made):
            return file
        result = {"name": each.name, "group": each.group, "seed": seed, "data": plan.selection, "made": made}
        result["text"] = described(dataset, plan.selection)
        if each.preset:
            torch.set_num_threads(1)  # sums in one order, so that a seed gives the same figures
            if not trained:
                _train(plan, each, seed, dataset, say, lambda share: progress(0.9 * share))
            result |= result_of(plan, each, seed, dataset)
        else:
            result |= _floor(plan, each, dataset, progress)
        write_json(file, result)
    progress(1.0)
    return file


def run_all(
    plan: Plan,
    tasks: Sequence[Task],
    jobs: int,
    say: Callable[[str], None],
    progress: Callable[[float], None],
) -> Generator[Path, None, None]:
    """Do runs of (variant, seed), some at a time in processes of their own, and yield each file as it is written.

    Raises:
        DatasetError: if the dataset does not fit.
        MotionkitError: a process of a run was killed.
        KeyboardInterrupt: Ctrl-C; runs in flight have written their checkpoints.
    """
    if jobs > 1:
        works = [
            (f"{each.name}, seed {seed}", partial(_quiet_run, plan, each.name, seed)) for each, seed in tasks
        ]
        yield from side_by_side(works, jobs, say, progress)
        return
    for number, (each, seed) in enumerate(tasks):
        say(f"{each.name}, seed {seed}")
        yield run_one(plan, each, seed, say, lambda share, n=number: progress((n + share) / len(tasks)))  # type: ignore[misc]


def _quiet_run(plan: Plan, name: str, seed: int, progress: Callable[[float], None]) -> Path:
    return run_one(plan, variant(name), seed, lambda text: None, progress)


# ---- one run ----


def _train(
    plan: Plan,
    each: Variant,
    seed: int,
    dataset: Dataset,
    say: Callable[[str], None],
    progress: Callable[[float], None],
) -> None:
    options, path = options_of(plan, each, seed), model_file(plan, each, seed)
    checkpoint = path.with_suffix(".run") / "checkpoint.safetensors"

    stopping = False

    def on_event(event: TrainEvent) -> None:
        nonlocal stopping
        stopping |= event.kind == "stop"
        if event.kind == "note" and not stopping:  # how a stopped run continues is for the caller to say
            say(event.text)
        if event.kind == "log" and options.steps:
            progress(event.step / options.steps)

    done = train(dataset, path, options, checkpoint.exists(), None, plan.device, on_event)
    if not done.finished:
        raise KeyboardInterrupt


def model_file(plan: Plan, each: Variant, seed: int) -> Path:
    """Return where the model of a run is written, beside the folder of its log."""
    return plan.checkpoints / plan.folder / f"{slug(each.name)}-{seed}.safetensors"


def result_of(plan: Plan, each: Variant, seed: int, dataset: Dataset) -> dict[str, Any]:
    """Test the model that a run has written, and return the fields of its result."""
    path, options = model_file(plan, each, seed), options_of(plan, each, seed)
    model, lines = load_model(path), _log(path.with_suffix(".run") / "log.jsonl")
    network = network_class(model.config.architecture).from_weights(model.network)
    network.to("cuda" if _on_gpu(plan.device) else "cpu")
    return {
        "budget": budget_of(plan.budget, options, plan.steps or lines[-1]["step"]),
        "parameters": parameter_count(network),
        "losses": _final(lines),
        "curve": _curve(lines),
        **tested(plan, each, seed, dataset, network),
        **measured(dataset, result_file(plan, each, seed), plan.longest),
        "timing": {
            "seconds": round(lines[-1]["seconds"], 1),
            "machine": model.card.get("machine", machine(plan.device)),  # it may be tested on another
        },
    }


def budget_of(name: str, options: TrainOptions, steps: int) -> dict[str, Any]:
    """Return what a result says of the training of its run."""
    optimizer = options.optimizer
    return {
        "name": name,
        "steps": steps,
        "batch": optimizer.batch,
        "window": options.sampler.window,
        "rate": optimizer.rate,
        "method": optimizer.method,
        "config": dict(BUDGETS[name].config),
    }


def tested(plan: Plan, each: Variant, seed: int, dataset: Dataset, network: Predictor) -> dict[str, Any]:
    """Return the fields of a result that a trained network is needed for, and keep its roll-outs beside the result.

    The network is on any device. All other fields come from the roll-outs, by measured.

    Raises:
        MotionkitError: the network predicts numbers that are not finite, or the file cannot be written.
    """
    network.eval()
    device = next(network.parameters()).device
    sequences, labelled = held_out(dataset, plan.longest), not each.learns_contacts
    draws = [seed * 1009 + number for number in range(len(sequences))] + [None] * len(sequences)
    made = roll_out(network, dataset, sequences * 2, draws, device, labelled)
    outputs = dict(zip(OUTPUTS, (made[: len(sequences)], made[len(sequences) :]), strict=True))
    keep_rollouts(rollouts_file(result_file(plan, each, seed)), dataset, outputs)
    return {
        "longest": plan.longest,
        "held-out": held_out_errors(network, dataset, device, seed, labelled),
        "derivatives": control_derivatives(network, dataset, sequences[0]),
    }


def measured(dataset: Dataset, file: Path, longest: int) -> dict[str, Any]:
    """Return the fields of a result that are measured in its kept roll-outs.

    Raises:
        MotionkitError: the roll-outs are not there, or of other sequences.
    """
    sequences = held_out(dataset, longest)
    made = read_rollouts(rollouts_file(file), dataset, sequences)

    def of(output: str) -> dict[str, Any]:
        return measure(dataset, lambda sequence, number: made[output][number], sequences, lambda share: None)

    return {**of("sample"), "by-mean": of("mean")["groups"]}


def measure_again(data: Path, results: Path) -> Generator[Path, None, None]:
    """Measure all runs anew whose roll-outs are kept below a folder of results, and yield each result as it is written.

    Raises:
        MotionkitError: a result or its roll-outs are damaged, or were made from other clips.
    """
    for file, result, dataset in kept_runs(data, results):
        result |= measured(dataset, file, result["longest"])
        check_result(result)
        write_json(file, result)
        yield file


def kept_runs(data: Path, results: Path) -> Iterator[tuple[Path, dict[str, Any], Dataset]]:
    """Yield each result below a folder whose roll-outs are kept: its file, its fields, and the data that it is of.

    Raises:
        MotionkitError: a result is damaged, or was made from other clips.
    """
    datasets: dict[str, tuple[Dataset, dict[str, str]]] = {}
    for kept in sorted(results.rglob("*.npz")):
        file = kept.with_suffix(".json")
        result = read_json(file, "the result of an experiment", MotionkitError)
        if not isinstance(result, dict) or not {"name", "seed", "data", "made", "longest"} <= set(result):
            raise MotionkitError(f"{file}: not the result of an experiment; delete it and {kept.name}")
        selection = str(result["data"])
        if selection not in datasets:
            dataset = select(data, selection)
            datasets[selection] = dataset, made_from(dataset)
        dataset, made = datasets[selection]
        _check_clips(file, result["made"], made, f"{data} ({selection})")
        yield file, result, dataset


def _check_clips(file: Path, found: dict[str, str], made: dict[str, str], where: str) -> None:
    other = [part for part in ("training", "test") if found[part] != made[part]]
    if other:
        raise MotionkitError(
            f"{file}: made from other {' and '.join(other)} clips than those of {where}; choose another --results, or "
            "delete it"
        )


def _floor(plan: Plan, each: Variant, dataset: Dataset, progress: Callable[[float], None]) -> dict[str, Any]:
    floor = FLOORS[each.name](dataset)
    sequences = held_out(dataset, plan.longest)
    measured = measure(dataset, floor, sequences, progress)
    return {"parameters": 0, "longest": plan.longest, **measured}


def _log(path: Path) -> list[dict[str, Any]]:
    """Return the lines of a training log, the last of those with the same step."""
    lines = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    return list({line["step"]: line for line in lines if line["kind"] == "log"}.values())


def _final(lines: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Return the means of each loss over the last tenth of the lines of a log."""
    last = lines[-max(1, len(lines) // 10) :]
    names = [name for name in last[0] if name not in ("kind", "step", "seconds", "rate")]
    return {name: rounded(sum(line[name] for line in last) / len(last), 5) for name in names}


def _curve(lines: Sequence[dict[str, Any]]) -> list[list[float]]:
    """Return [step, total loss] at up to CURVE_POINTS places of a log, each the mean of the steps around it."""
    size = -(-len(lines) // CURVE_POINTS)
    parts = [lines[i : i + size] for i in range(0, len(lines), size)]
    return [[part[-1]["step"], rounded(sum(line["total"] for line in part) / len(part), 5)] for part in parts]


def machine(device: str) -> str:
    """Return the processor a run used, for people."""
    return torch.cuda.get_device_name() if _on_gpu(device) else f"CPU, one thread ({platform.machine()})"


def _on_gpu(device: str) -> bool:
    return device.startswith("cuda") or (device == "auto" and torch.cuda.is_available())


def read_results(folder: Path) -> list[dict[str, Any]]:
    """Return all results below a folder, by data set, budget, name and seed.

    Raises:
        MotionkitError: for a file that is none.
    """
    return [
        read_result(path) | {"folder": path.parent.relative_to(folder).as_posix()}
        for path in sorted(folder.rglob("*.json"))
    ]


def read_result(path: Path) -> dict[str, Any]:
    """Return one result with all that tables and figures take from it.

    Raises:
        MotionkitError: the file is none, a field is missing or of another type, or its names are unknown.
    """
    try:
        result = read_json(path, "the result of an experiment", MotionkitError)
        check_result(result)
    except MotionkitError as error:
        fault = str(error).removeprefix(f"{path}: ")
        raise MotionkitError(
            f"{path}: not the result of an experiment ({fault}); delete it and run it again"
        ) from None
    return result
