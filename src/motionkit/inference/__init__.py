"""Model and controls of a frame in, the next frame out: step, sampling, corrections, roll-outs, live bodies."""
