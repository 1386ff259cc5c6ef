"""Motion to the 276 features and the control signals of every frame, and back."""
