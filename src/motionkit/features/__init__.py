"""Motion in, the 276 numbers of every frame and the control signals out, and back."""
