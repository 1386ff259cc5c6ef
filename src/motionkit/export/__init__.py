"""Motions and models in, files for other programs out: glTF, VRM animation, USD, tables, ONNX graphs."""
