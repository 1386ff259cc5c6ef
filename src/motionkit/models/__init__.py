"""Windows of features and controls in, the Gaussian of the next frame out."""
