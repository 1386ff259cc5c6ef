"""Root-height correction: a body whose rotations put its feet lower than the frame says they are is raised.

A frame says twice how high its feet are: by their positions, and by the rotations that lead to them. What the network
does not know of a bent leg it draws as its mean, which is a straighter leg and so a longer one: in squats, strikes and
landings rotations put the feet up to a hand's breadth under the floor, positions do not. The root is raised by what is
missing, slowly, while feet are low, and the less the more it is: so far apart are only whirls, whose positions are no
better. What is deeper under the floor than recorded feet are is raised faster, whatever positions say. Nothing of it
goes back into the network. frame_kernel.c and export/onnx_body.py do it.
"""

from __future__ import annotations

REACH = 10.0  # cm above the floor from which on feet tell nothing
PACE = 0.05  # share of what is missing that the root is raised by in a frame
DOUBT = 4.0  # Gap (cm) at which the correction halves
# cm that a foot may be lower than where it stands, and the share of the rest that the root is raised by in a frame
DEEPEST, LIFT = 5.0, 0.2
