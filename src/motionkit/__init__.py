"""motionkit: BVH recordings in, a controllable real-time motion model, BVH out."""

__version__ = "0.1.0"
