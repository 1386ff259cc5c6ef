"""Recorded performances that decide which way a flip goes."""

import pytest
import torch

from motionkit.synthesis.plan import TypePart, plan_tracks


@pytest.fixture
def flips(tiny_model):
    assert tiny_model.tracks["cartwheel"], "the tiny dataset has a type that turns over"
    return tiny_model


def test_tracks_count_only_while_their_type_is_asked_for(flips):
    parts = [TypePart("walking", 1.0), TypePart("cartwheel", 0.5), TypePart("walking", 0.5)]
    trajectory, given = plan_tracks(flips, parts)
    assert trajectory.shape == (120, 24)
    assert given.tolist() == [0.0] * 60 + [1.0] * 30 + [0.0] * 30
    assert torch.equal(trajectory[:60], torch.zeros(60, 24))
    assert torch.equal(trajectory[60:90], flips.tracks["cartwheel"][0][:30])


def test_a_second_performance_begins_where_the_first_ends(flips):
    length = len(flips.tracks["cartwheel"][0])
    trajectory, _ = plan_tracks(flips, [TypePart("cartwheel", 2 * length / flips.fps)])
    assert torch.equal(trajectory[:length], trajectory[length : 2 * length])


def test_first_part_goes_on_from_its_seed_and_choice_picks_a_track(flips):
    track = flips.tracks["cartwheel"][0]
    trajectory, _ = plan_tracks(flips, [TypePart("cartwheel", 10 / flips.fps)], first_frame=5)
    assert torch.equal(trajectory, track[5:15])
    again, _ = plan_tracks(
        flips, [TypePart("cartwheel", 10 / flips.fps)], choice=len(flips.tracks["cartwheel"])
    )
    assert torch.equal(again, track[:10])
    assert flips.phase_seconds("cartwheel") == pytest.approx(len(track) / flips.fps)
