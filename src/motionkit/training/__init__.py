"""A dataset in, a trained model file out."""
