"""Settings of the root-height correction, which raises a body whose rotations put its feet too low.

A frame gives the height of its feet twice: by joint positions, and by the rotations that lead to the feet. The network
predicts the mean rotation of a leg that may bend more or less, and that leg is too straight and too long. So in squats,
strikes and landings rotations put the feet up to 10 cm below the floor, while positions do not. While feet are low, the
root rises slowly by the gap. A larger gap counts less: it occurs in fast turns, where positions are no better. A foot
deeper below the floor than recorded feet raises the root faster, whatever positions say. The network never sees this
rise. frame_kernel.c and export/onnx_body.py compute it.
"""

from __future__ import annotations

REACH = 10.0  # cm above the floor; higher feet do not count
PACE = 0.05  # share of the gap by which the root rises per frame
DOUBT = 4.0  # gap (cm) at which the correction halves
# Depth (cm) below standing height that a foot may reach, and the share of any excess by which the root rises per frame.
DEEPEST, LIFT = 5.0, 0.2
