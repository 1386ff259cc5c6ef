"""The laboratory, which only the command line and the door import: models in, what they are worth in numbers out."""
