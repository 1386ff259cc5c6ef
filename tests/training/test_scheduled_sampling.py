"""Scheduled sampling: windows whose inputs are predictions of the network."""

from dataclasses import replace

import pytest
import torch

from motionkit.data.dataset import Dataset
from motionkit.features.control import ControlLayout
from motionkit.features.layout import FEATURE_COUNT, feature_layout
from motionkit.models.batch import FeatureSpace
from motionkit.models.network import PartTransformer
from motionkit.models.presets import preset
from motionkit.training.losses import Batch
from motionkit.training.presets import train_options
from motionkit.training.sampler import WindowSampler, window_generator
from motionkit.training.scheduled_sampling import (
    PredictedInputs,
    ScheduledSamplingOptions,
    sampled_windows,
)
from motionkit.training.window_blocks import WindowBlocks
from motionkit.training.windows import ControlSampling, SamplerOptions

ROOT = feature_layout().blocks["root_rotation"]
OTHERS = [column for column in range(FEATURE_COUNT) if not ROOT.start <= column < ROOT.stop]
ALWAYS = ScheduledSamplingOptions(
    back=0.0, limit=1e9, reference_back=0.0, reference_limit=1e9, temperature=0.0
)


@pytest.fixture(scope="module")
def sampler(dataset: Dataset) -> WindowSampler:
    return WindowSampler(
        dataset, SamplerOptions(window=24, splices=0, controls=ControlSampling(reference_dropout=0.6))
    )


@pytest.fixture(scope="module")
def batch(sampler: WindowSampler) -> Batch:
    return sampler.batch(0, 4)


@pytest.fixture(scope="module")
def network(dataset: Dataset) -> PartTransformer:
    torch.manual_seed(0)
    network = PartTransformer(preset("tiny"), ControlLayout(dataset.types).size)
    with torch.no_grad():
        network.aggregate.weight.mul_(5.0)
    return network.train()


def run_on_predictions(
    network: PartTransformer,
    batch: Batch,
    options: ScheduledSamplingOptions,
    generators: list[torch.Generator],
    sampler: WindowSampler,
) -> Batch:
    references = torch.from_numpy(sampler.windows.references.matrix)
    return PredictedInputs(network, references, FeatureSpace.of(sampler.dataset))(batch, options, generators)


def generators(count: int = 4) -> list[torch.Generator]:
    return [window_generator(0, 0, i, 1) for i in range(count)]


def test_inputs_are_the_predictions_of_the_frames_before(
    network: PartTransformer, batch: Batch, sampler: WindowSampler
) -> None:
    fed = run_on_predictions(network, batch, ALWAYS, generators(), sampler)
    assert network.training
    network.eval()
    with torch.no_grad():
        made = network(fed.inputs, fed.contacts, fed.controls)
    network.train()
    assert torch.equal(fed.inputs[:, 0], batch.inputs[:, 0])
    apart = (fed.inputs[:, 1:] - made.mean[:, :-1]).abs()
    assert apart[..., OTHERS].max() < 1e-4
    assert torch.allclose(fed.contacts[:, 1:], torch.sigmoid(made.contact_logits[:, :-1]), atol=1e-4)
    assert torch.equal(fed.targets, batch.targets) and torch.equal(fed.mask, batch.mask)


def test_the_root_rotation_of_predictions_is_a_rotation_as_in_synthesis(
    network: PartTransformer, batch: Batch, sampler: WindowSampler
) -> None:
    fed = run_on_predictions(network, batch, ALWAYS, generators(), sampler)
    network.eval()
    with torch.no_grad():
        made = network(fed.inputs, fed.contacts, fed.controls)
    network.train()
    denormalize = FeatureSpace.of(sampler.dataset).denormalize
    drawn = denormalize(made.mean[:, :-1])[..., ROOT].unflatten(-1, (2, 3))
    first, second = denormalize(fed.inputs[:, 1:])[..., ROOT].unflatten(-1, (2, 3)).unbind(-2)
    assert (drawn.norm(dim=-1) - 1.0).abs().max() > 0.01
    assert torch.allclose(first.norm(dim=-1), torch.ones(1), atol=1e-5)
    assert torch.allclose(second.norm(dim=-1), torch.ones(1), atol=1e-5)
    assert (first * second).sum(-1).abs().max() < 1e-5
    assert torch.allclose(torch.cosine_similarity(first, drawn[..., 0, :], dim=-1), torch.ones(1), atol=1e-4)


def test_recorded_frames_take_over_and_do_not_count_there(
    network: PartTransformer, batch: Batch, sampler: WindowSampler
) -> None:
    fed = run_on_predictions(
        network, batch, replace(ALWAYS, back=0.3, reference_back=0.3), generators(), sampler
    )
    own = (fed.inputs != batch.inputs).any(dim=-1)
    assert 0.4 < float(own[:, 1:].float().mean()) < 0.95
    returns = own[:, :-1] & ~own[:, 1:]
    assert returns.any()
    assert torch.equal(fed.mask[:, 1:] == 0, returns | (batch.mask[:, 1:] == 0))


def test_a_prediction_too_far_off_is_not_used(
    network: PartTransformer, batch: Batch, sampler: WindowSampler
) -> None:
    fed = run_on_predictions(
        network, batch, replace(ALWAYS, limit=0.0, reference_limit=0.0), generators(), sampler
    )
    assert torch.equal(fed.inputs, batch.inputs) and torch.equal(fed.mask, batch.mask)


def test_windows_are_the_same_alone_and_together(
    network: PartTransformer, batch: Batch, sampler: WindowSampler
) -> None:
    options = ScheduledSamplingOptions(limit=1e9, reference_limit=1e9)
    together = run_on_predictions(network, batch, options, generators(), sampler)
    alone = [run_on_predictions(network, batch[[i]], options, [generators()[i]], sampler) for i in range(4)]
    assert torch.allclose(Batch.joined(alone).inputs, together.inputs, atol=1e-4)


def test_reference_poses_are_relative_to_the_predictions(
    network: PartTransformer, batch: Batch, dataset: Dataset, sampler: WindowSampler
) -> None:
    fed = run_on_predictions(network, batch, ALWAYS, generators(), sampler)
    layout = ControlLayout(dataset.types)
    reference_gain = batch.controls[..., layout.reference_gain] > 0
    assert reference_gain.any() and not reference_gain.all()
    # The reference pose itself stays the same.
    references = torch.from_numpy(sampler.windows.references.matrix)
    before = batch.controls[..., layout.reference] + batch.inputs @ references
    after = fed.controls[..., layout.reference] + fed.inputs @ references
    assert torch.allclose(before[reference_gain], after[reference_gain], rtol=1e-3, atol=1e-3)
    assert not torch.equal(fed.controls, batch.controls)
    assert torch.equal(fed.controls[~reference_gain], batch.controls[~reference_gain]), (
        "windows without references are unchanged"
    )


def test_reference_poses_and_a_phase_allow_longer_runs(
    network: PartTransformer, batch: Batch, sampler: WindowSampler
) -> None:
    options = replace(ALWAYS, back=1.0, reference_back=0.0)
    layout = ControlLayout(("",) * (batch.controls.shape[-1] - ControlLayout(()).size))
    controls = batch.controls.clone()
    controls[..., layout.phase] = 0.0
    controls[1, 5:9, layout.phase] = torch.tensor([0.6, 0.8])
    fed = run_on_predictions(network, replace(batch, controls=controls), options, generators(), sampler)
    timed = controls[..., layout.reference_gain] > 0
    assert not timed.all()
    timed[1, 5:9] = True
    own = (fed.inputs != batch.inputs).any(dim=-1)
    assert torch.equal(own[:, 1:], timed[:, :-1])


@pytest.mark.parametrize("share", [0.0, 0.25, 0.4, 0.5, 1.0])
def test_the_share_of_windows_does_not_depend_on_processes(share: float) -> None:
    whole = sampled_windows(0, 16, share)
    halves = sampled_windows(0, 8, share) + [8 + i for i in sampled_windows(8, 8, share)]
    assert whole == halves and len(whole) == int(16 * share)


def test_the_noise_has_deviation_one_from_the_first_frame(
    network: PartTransformer, batch: Batch, sampler: WindowSampler
) -> None:
    noisy = replace(ALWAYS, temperature=1e-3)
    quiet = replace(ALWAYS, temperature=0.0)
    first = [
        run_on_predictions(network, batch, o, generators(), sampler).inputs[:, 1] for o in (noisy, quiet)
    ]
    network.eval()
    with torch.no_grad():
        made = network(batch.inputs, batch.contacts, batch.controls)
    network.train()
    noise = ((first[0] - first[1]) / 1e-3 * torch.exp(-made.log_sigma[:, 0]))[:, OTHERS]
    assert float(noise.std()) == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize(("batch", "processes"), [(1, 1), (2, 1), (16, 2)])
def test_batches_of_any_size_have_the_share(
    network: PartTransformer, sampler: WindowSampler, batch: int, processes: int
) -> None:
    options = train_options(
        "tiny", steps=99, batch=batch, share=0.4, limit=1e9, reference_limit=1e9, back=0.0
    )
    options = replace(options, sampler=sampler.options, stages=())
    fed = 0
    for first in range(0, batch, batch // processes):
        places = range(first, first + batch // processes)
        blocks = WindowBlocks(sampler, network, options, places)
        for step in range(16):
            made = blocks.next(step, 0.0)
            assert len(made.inputs) == len(places)
            recorded = {x.numpy().tobytes() for x in sampler.batch(step, batch, first, len(places)).inputs}
            fed += sum(x.numpy().tobytes() not in recorded for x in made.inputs)
        blocks.close()
    assert fed == int(0.4 * 16 * batch)


def test_the_step_in_c_and_the_one_in_torch_make_the_same_inputs(
    network: PartTransformer, batch: Batch, sampler: WindowSampler, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = ScheduledSamplingOptions(back=0.2, limit=2.0)
    quick = run_on_predictions(network, batch, options, generators(), sampler)
    monkeypatch.setattr("motionkit.training.scheduled_sampling.why_not_packable", lambda _: "for the test")
    plain = run_on_predictions(network, batch, options, generators(), sampler)
    assert not torch.equal(quick.inputs, batch.inputs)
    assert torch.allclose(quick.inputs, plain.inputs, atol=2e-2) and torch.equal(quick.mask, plain.mask)
