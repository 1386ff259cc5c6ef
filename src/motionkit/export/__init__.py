"""A model in, a graph for game engines out."""
