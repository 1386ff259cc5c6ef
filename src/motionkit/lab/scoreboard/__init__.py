"""A model and a dataset in, the scoreboard out: accuracy, stability, reconstruction, paths, response, smoothness."""
