"""Flights of whole motions fall freely: from take-off to landing the centre of mass goes along a parabola.

A network that answers with the mean of what may come falls too slowly in some jumps, and too fast in others. Take-off
and landing stay where they are; live characters do not know when they will land, and fall as the network has it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import smoothstep
from motionkit.metrics.flight import FREE_FALL, centre_of_mass, flights
from motionkit.metrics.touch import FALL_ERROR, touching
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion

# m/s^2; what is further from free fall is no flight but a body on its hands, or one that glides. What is nearer than
# FALL_ERROR stays as it is.
NEAR = 4.5
EASE = 5  # frames over which a correction comes and goes, since a corner in the way jerks


def falling_freely(motion: Motion) -> Motion:
    """Return a motion at 60 fps, the ground at height zero, whose flights of at least 0.2 s fall freely."""
    positions = motion_kinematics(motion)[1]
    if len(positions) < 3:
        return motion
    heights = centre_of_mass(positions)[:, 1]
    roots = motion.root_positions.copy()
    for flight in flights(positions, ~touching(positions)):
        before, after = flight.start - 1, flight.end
        if before < 0 or after >= len(positions) or not FALL_ERROR < abs(flight.error) <= NEAR:
            continue
        frames = np.arange(before, after + 1)
        since, left = frames - before, after - frames
        straight = np.interp(frames, [before, after], heights[[before, after]])
        wanted = straight - 0.5 * 100.0 * FREE_FALL * since * left / motion.fps**2
        ease = smoothstep(np.minimum(np.minimum(since, left) / EASE, 1.0))
        roots[frames, 1] += (ease * (wanted - heights[frames])).astype(roots.dtype)
    return replace(motion, root_positions=roots)
