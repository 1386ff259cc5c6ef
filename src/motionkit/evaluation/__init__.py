"""A model and a dataset in, the scoreboard out: obedience, endurance, likeness, paths, response, smoothness."""
