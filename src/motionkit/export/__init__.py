"""Motions and models in, files for other programs out: a user's rig, glTF, VRM animation, USD, tables, ONNX graphs."""
