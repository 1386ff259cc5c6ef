"""A model in, an ONNX graph for game engines out."""
